"""`robbie recording cut|filter|merge`: a new recording of parts of others."""

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from datetime import datetime
from itertools import pairwise
from pathlib import Path

from robbie_mp.base.amount import BadAmount, seconds_of
from robbie_mp.base.utc import time_from
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.log_files import add_limit_argument, add_log_argument, progress_bar
from robbie_mp.cli.output import warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.logs.capture.selection import Selection
from robbie_mp.logs.recording.editing import Cut, edit
from robbie_mp.logs.recording.format import RUN_METADATA
from robbie_mp.logs.recording.reader import Log, LogChannel, channel_name, open_log

NOTHING = 1


def add_parsers(actions: Commands) -> None:
    """Add `cut`, `filter` and `merge` to the actions of `robbie recording`."""
    cut_parser = add_command(
        actions,
        "cut",
        "cut a time out of a recording",
        "Write a new recording with the messages of a time. The old recording is only read.",
        [
            "robbie recording cut monday --from 60 --to 90.5 -o crash.mcap",
            "robbie recording cut monday --from 2026-11-22T14:30:00Z -o afternoon.mcap",
        ],
    )
    add_log_argument(cut_parser)
    for option, text in (("--from", "begin at this time"), ("--to", "end before this time")):
        cut_parser.add_argument(
            option,
            dest=option.strip("-"),
            metavar="TIME",
            type=_moment,
            help=f"{text}: after the beginning (90s, 1h30min), or ISO 8601 with Z or an offset",
        )
    cut_parser.set_defaults(command=cut)
    filter_parser = add_command(
        actions,
        "filter",
        "take messages of some types or topics out of a recording",
        "Write a new recording with the messages whose type and topic match. Patterns are shell patterns; "
        "messages without a topic go by their short type name. The old recording is only read.",
        [
            "robbie recording filter monday --topic 'laser/*' --topic odom -o small.mcap",
            "robbie recording filter monday --not Image --not 'debug/*' -o small.mcap",
        ],
    )
    add_log_argument(filter_parser)
    for option, text in (
        ("--type", "take messages of these types"),
        ("--topic", "take messages on these topics"),
        ("--not", "leave out messages of these types or topics"),
    ):
        filter_parser.add_argument(
            option,
            dest=f"{option.strip('-')}s",
            action="append",
            default=[],
            metavar="PATTERN",
            help=f"{text}; may be repeated",
        )
    filter_parser.set_defaults(command=filter_log)
    merge_parser = add_command(
        actions,
        "merge",
        "merge several recordings into one",
        "Write a new recording with the messages of several recordings, ordered by their time. The clocks of "
        "different runs are taken as they are. The old recordings are only read.",
        ["robbie recording merge robot-a robot-b -o both.mcap"],
    )
    add_log_argument(merge_parser, "logs", nargs="+")
    merge_parser.set_defaults(command=merge)
    for parser in (cut_parser, filter_parser, merge_parser):
        parser.add_argument(
            "-o", "--output", type=Path, metavar="OUT", required=True, help="the new file, such as part.mcap"
        )
        add_limit_argument(parser)


def _moment(text: str) -> float | datetime:
    """Parse a time after the beginning, in s, or one with its offset from UTC."""
    try:
        seconds_of(text)
    except BadAmount:
        pass
    else:
        return time_between(0)(text)
    try:
        time = time_from(text)
    except ValueError:
        time = None
    if time is None or time.tzinfo is None:
        raise argparse.ArgumentTypeError(
            "expected a time after the beginning, such as 1min30s, or one with its offset, such as "
            f"2026-11-22T14:30:00Z; got {text!r}"
        )
    return time


def cut(arguments: argparse.Namespace) -> int:
    """Cut a time out of a recording."""
    with open_log(arguments.log, arguments.limits) as log:
        start_ns, end_ns = (
            None if moment is None else _time_ns(log, moment)
            for moment in (getattr(arguments, "from"), arguments.to)
        )
        said = " ".join(
            f"--{name} {value}" for name in ("from", "to") if (value := getattr(arguments, name)) is not None
        )
        return _write([log], arguments.output, f"cut {said}".strip(), Cut(start_ns, end_ns))


def _time_ns(log: Log, moment: float | datetime) -> int:
    if isinstance(moment, datetime):
        return round(moment.timestamp() * 1e6) * 1000
    return log.start_ns + round(moment * 1e9)


def filter_log(arguments: argparse.Namespace) -> int:
    """Take messages of some types or topics out of a recording."""
    topics = [pattern.removeprefix("/") for pattern in arguments.topics]
    selection = Selection.by_types_and_topics(
        arguments.types or ["*"], topics or ["*"], [pattern.removeprefix("/") for pattern in arguments.nots]
    )

    def wants(channel: LogChannel) -> bool:
        return selection.wants(channel.type_name, channel_name(channel))

    with open_log(arguments.log, arguments.limits) as log:
        options = {"type": arguments.types, "topic": arguments.topics, "not": arguments.nots}
        said = " ".join(f"--{name} {one}" for name, patterns in options.items() for one in patterns)
        code = _write([log], arguments.output, f"filter {said}".strip(), Cut(wants=wants))
        for name in selection.unmatched:
            warn(f"{name}: no messages in {log.path} match")
        return code


def merge(arguments: argparse.Namespace) -> int:
    """Merge several recordings."""
    with ExitStack() as opened:
        logs = [opened.enter_context(open_log(path, arguments.limits)) for path in arguments.logs]
        for line in _about_clocks(logs):
            warn(line)
        return _write(logs, arguments.output, "merge", Cut())


def _about_clocks(logs: Sequence[Log]) -> list[str]:
    """Say what merging by time means for recordings of different runs."""
    runs = {record.get("run_id", "") for log in logs for record in log.metadata(RUN_METADATA)}
    lines = []
    if len(runs) > 1 or any(not log.metadata(RUN_METADATA) for log in logs):
        lines.append(
            "the recordings are of different runs: messages are ordered by the times in the recordings, "
            "and clocks that differed are not corrected; sequence numbers are those of each run"
        )
    filled = sorted((log for log in logs if log.message_count), key=lambda log: log.start_ns)
    for before, after in pairwise(filled):
        if after.start_ns > before.end_ns:
            gap_s = (after.start_ns - before.end_ns) / 1e9
            lines.append(f"{after.path} begins {gap_s:.3f} s after {before.path} has ended")
    return lines


def _write(logs: Sequence[Log], target: Path, operation: str, what: Cut) -> int:
    with progress_bar(f"writing {target.name}") as progress:
        done = edit(logs, target, operation, progress, what)
    for log in logs:
        for line in log.damage:
            warn(f"{line}; only the intact part was copied")
    for note in done.notes:
        warn(note)
    carried = f", and {done.carried} older ones that were newest before" if done.carried else ""
    print(f"{target}: {done.messages} of {sum(log.message_count for log in logs)} messages{carried}")
    if not done.messages and not done.carried:
        warn("the new recording is empty: no message was selected")
        return NOTHING
    return 0
