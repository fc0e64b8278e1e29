"""`robbie import-carmen IN OUT`: make a recording of a CARMEN log."""

import argparse
from pathlib import Path

from robbie_mp.base.balance import Balance
from robbie_mp.cli.log_files import add_strict_argument, print_balance, progress_bar
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.logs.recording.carmen_import import import_carmen as convert


def add_parser(subparsers: Commands) -> None:
    """Add `import-carmen` to the commands."""
    parser = add_command(
        subparsers,
        "import-carmen",
        "convert a CARMEN log to a recording",
        "Convert odometry, laser scans, positions and inertial data from CARMEN's text format, which many "
        "public data sets use, to a recording. Lines that cannot be used are left out and counted.",
        ["robbie import-carmen intel.clf intel.mcap"],
    )
    parser.add_argument("source", metavar="IN", type=Path, help="log in CARMEN's format, also compressed")
    parser.add_argument("target", metavar="OUT", type=Path, help="new recording, an MCAP file")
    add_strict_argument(parser)
    parser.set_defaults(command=import_carmen)


def import_carmen(arguments: argparse.Namespace) -> int:
    """Convert the log."""
    balance = Balance(is_strict=arguments.strict)
    with progress_bar(f"importing {arguments.source.name}") as progress:
        convert(arguments.source, arguments.target, balance, progress=progress)
    return print_balance(arguments.target, balance)
