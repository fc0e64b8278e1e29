"""`robbie recording cut|filter|merge|repair`: new recordings from others."""

import argparse
from typing import TYPE_CHECKING

from robbie_mp.cli import recording_edit, recording_repair

if TYPE_CHECKING:
    from argparse import _SubParsersAction


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `recording` to the commands."""
    parser = subparsers.add_parser("recording", help="cut, filter, merge or repair recordings")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    recording_edit.add_parsers(actions)
    recording_repair.add_parser(actions)
