"""`robbie import-rosbag IN OUT`: make a recording of a bag of ROS."""

import argparse
from pathlib import Path

from robbie_mp.base.balance import Balance
from robbie_mp.cli.log_files import add_strict_argument, print_balance, progress_bar
from robbie_mp.cli.output import warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.logs.recording.rosbag_import import import_rosbag as convert


def add_parser(subparsers: Commands) -> None:
    """Add `import-rosbag` to the commands."""
    parser = add_command(
        subparsers,
        "import-rosbag",
        "convert a ROS 1 or ROS 2 bag to a recording",
        "Convert a ROS bag to a recording. ROS 1 messages become ROS 2 messages; types unknown to Robbie "
        "keep their definitions. This needs the library rosbags: pip install rosbags.",
        ["robbie import-rosbag drive.bag drive.mcap", "robbie import-rosbag rosbag2_folder drive.mcap"],
    )
    bags = "ROS 1 .bag file, or ROS 2 bag: its folder, or one .mcap or .db3 file"
    parser.add_argument("source", metavar="IN", type=Path, help=bags)
    parser.add_argument("target", metavar="OUT", type=Path, help="new recording, an MCAP file")
    add_strict_argument(parser)
    parser.set_defaults(command=import_rosbag)


def import_rosbag(arguments: argparse.Namespace) -> int:
    """Convert the bag."""
    balance = Balance(is_strict=arguments.strict)
    with progress_bar(f"importing {arguments.source.name}") as progress:
        notes = convert(arguments.source, arguments.target, balance, progress=progress)
    for note in notes:
        warn(note)
    return print_balance(arguments.target, balance)
