"""`robbie recording cut|filter|merge|repair`: new recordings from others."""

from robbie_mp.cli import recording_edit, recording_repair
from robbie_mp.cli.parser import Commands


def add_parser(subparsers: Commands) -> None:
    """Add `recording` to the commands."""
    parser = subparsers.add_parser("recording", help="cut, filter, merge or repair recordings")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    recording_edit.add_parsers(actions)
    recording_repair.add_parser(actions)
