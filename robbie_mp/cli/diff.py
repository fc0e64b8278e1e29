"""`robbie diff A B`: compare two recordings, message by message."""

import argparse
import json
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict

from rich.text import Text

from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli import completers
from robbie_mp.cli.log_files import (
    add_limit_argument,
    add_log_argument,
    add_topics_argument,
    progress_bar,
    warn_of_unmatched,
)
from robbie_mp.cli.output import console, warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.logs.recording.comparison import ChannelComparison, ComparisonOptions, compare
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import ModuleState

DIFFERENT = 1


def add_parser(subparsers: Commands) -> None:
    """Add `diff` to the commands."""
    parser = add_command(
        subparsers,
        "diff",
        "compare two recordings message by message",
        "Compare the messages of each channel (topic, type and sender) of two recordings, in order and bit "
        "by bit. Publishing times are ignored. Exit code 0: all messages are equal; 1: they are not.",
        [
            "robbie diff first second",
            "robbie diff first second --topics 'map*' --ignore-stamps --json",
            "robbie diff recorded played --exclude ModuleState --ignore-sender",
        ],
    )
    add_log_argument(parser, "a")
    add_log_argument(parser, "b")
    add_topics_argument(parser)
    excluded = parser.add_argument(
        "--exclude",
        nargs="+",
        default=[],
        metavar="PATTERN",
        help="leave out these topics (shell patterns); messages without a topic go by their short type name",
    )
    excluded.completer = completers.log_topics  # type: ignore[attr-defined]
    add_limit_argument(parser)
    parser.add_argument("--ignore-stamps", action="store_true", help="ignore the time stamps in headers")
    parser.add_argument(
        "--ignore-sender",
        action="store_true",
        help="compare messages whichever module sent them, as in a recording and its playback",
    )
    parser.add_argument("--json", action="store_true", help="print JSON for a program to read")
    parser.set_defaults(command=diff)


def diff(arguments: argparse.Namespace) -> int:
    """Compare two recordings, and print the differences."""
    with (
        closing(open_log(arguments.a, arguments.limits)) as a,
        closing(open_log(arguments.b, arguments.limits)) as b,
    ):
        for patterns in (arguments.topics, arguments.exclude):
            warn_of_unmatched([*a.channels, *b.channels], patterns)
        options = ComparisonOptions(
            arguments.topics, arguments.exclude, arguments.ignore_stamps, arguments.ignore_sender
        )
        with progress_bar("comparing") as progress:
            found = compare(a, b, options, progress)
        for line in [*a.damage, *b.damage]:
            warn(f"{line}; only the intact part was compared")
    if arguments.json:
        print(json.dumps([_as_data(one) for one in found], indent=2))
    else:
        _print(found)
    return 0 if all(one.is_equal for one in found) else DIFFERENT


def _as_data(one: ChannelComparison) -> dict[str, object]:
    return {
        **one.channel._asdict(),
        "equal": one.equal,
        "different": one.different,
        "only_in_a": one.only_in_a,
        "only_in_b": one.only_in_b,
        "first_difference": one.first and asdict(one.first),
    }


def _print(found: Sequence[ChannelComparison]) -> None:
    table = PlainTable()
    for heading, left_out in (("topic", 0), ("type", 2), ("sender", 1)):
        table.add_column(heading, left_out=left_out, shrinks=True, no_wrap=True)
    for heading in ("equal", "different", "only in A", "only in B"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in found:
        bad = (one.different, one.only_in_a, one.only_in_b)
        table.add_row(
            one.channel.topic,
            one.channel.type_name,
            "any" if one.channel.sender is None else one.channel.sender,
            str(one.equal),
            *(Text(str(count), "bold red" if count else "") for count in bad),
        )
    console().print(table)
    for one in found:
        if first := one.first:
            topic, type_name, _ = one.channel
            print(
                one_line(
                    f"{topic or type_name}: message {first.index}: "
                    f"{first.field}: {first.a} in A, {first.b} in B"
                )
            )
    _hint_at_states(found)
    if all(one.is_equal for one in found):
        print(f"equal: {sum(one.equal for one in found)} messages")


def _hint_at_states(found: Sequence[ChannelComparison]) -> None:
    """Say why two runs never have the same states, if nothing else differs."""
    if {one.channel.type_name for one in found if not one.is_equal} == {ModuleState.type_name}:
        print(
            "only ModuleState differs: it says when each process started and with which pid, "
            "which no two runs share; leave it out with --exclude ModuleState"
        )
