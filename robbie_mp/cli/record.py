"""`robbie record [PATTERN...]`: record messages of a run that is already going."""

import argparse
import logging
import math
import sys
import time
from contextlib import closing
from pathlib import Path

from robbie_mp.attached.tool.message_stream import MessageStream
from robbie_mp.attached.tool.tool import RunEnded
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.priority import lower_priority
from robbie_mp.base.utc import file_stamp
from robbie_mp.bus.transport.records import ANY_VERSION
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.cli import completers
from robbie_mp.cli.amounts import time_between
from robbie_mp.cli.channel_choice import unknown_names
from robbie_mp.cli.info import print_log
from robbie_mp.cli.output import warn
from robbie_mp.cli.parser import Commands, add_command
from robbie_mp.cli.program import signals_noted
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.logs.capture.recorded_run import RecordedRun
from robbie_mp.logs.capture.recording_session import RecordingSession
from robbie_mp.logs.capture.selection import Selection
from robbie_mp.logs.recording.chunk import Compression
from robbie_mp.logs.recording.chunk_queue import BufferLimits
from robbie_mp.logs.recording.disk_budget import DiskBudget
from robbie_mp.logs.recording.format import ChannelKey
from robbie_mp.logs.recording.log_writer import LogWriter, Split
from robbie_mp.logs.recording.recorder import LOGGER_NICE
from robbie_mp.run.run_directory import KnownRun

LIMITS = BufferLimits(chunk_bytes=1 << 20, buffer_bytes=1 << 28, close_after_s=0.5)
PART_BYTES = 1 << 30
COUNT_EVERY_S = 1.0
LOG = logging.getLogger("robbie.record")


class FolderExists(RobbieError, FileExistsError):
    """The folder for a recording exists already."""


def add_parser(subparsers: Commands) -> None:
    """Add `record` to the commands."""
    parser = add_command(
        subparsers,
        "record",
        "record messages of a run",
        "Record messages of a run until Ctrl-C or the end of the run. The robot does not wait "
        "for it: messages that arrive too fast are dropped, and counted in the recording. To record a "
        "whole run from its start, add a message logger to its profile.",
        [
            "robbie record",
            "robbie record LaserScan Odometry -o monday",
            "robbie record 'camera/*' --exclude Image --duration 2min",
        ],
    )
    pattern = parser.add_argument(
        "pattern",
        nargs="*",
        metavar="PATTERN",
        help="types or topics to record, such as LaserScan, sensor_msgs/* or camera/*; default: all",
    )
    pattern.completer = completers.types  # type: ignore[attr-defined]
    parser.add_argument(
        "--exclude",
        metavar="PATTERN",
        action="append",
        default=[],
        help="types or topics not to record; may be repeated",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        type=Path,
        help="new folder for the recording; default: named by the date",
    )
    parser.add_argument(
        "--compression",
        choices=[str(one) for one in Compression],
        default="zstd",
        help="compression (zstd)",
    )
    parser.add_argument("--duration", metavar="TIME", type=time_between(0), help="stop after this time")
    add_run_argument(parser)
    parser.set_defaults(command=record)


def record(arguments: argparse.Namespace) -> int:
    """Record, and print a description of the recording."""
    run = choose_run(arguments.run)
    folder = arguments.output or Path(f"{file_stamp()}-{run.run_id}")
    if folder.exists():
        raise FolderExists(f"{folder} exists already; name a new folder with -o")
    selection = Selection.by_either(arguments.pattern or ["*"], arguments.exclude)
    for unknown in unknown_names(run, arguments.pattern):
        warn(unknown)
    logging.basicConfig(format="(%(message)s)", stream=sys.stderr)
    lower_priority(LOGGER_NICE, logging.getLogger(__name__))
    with closing(RecordedRun(run.folder)) as recorded:
        _record(run, recorded, selection, folder, arguments)
    for pattern in selection.unmatched:
        print(f"(nothing was recorded for {pattern})", file=sys.stderr)
    if not folder.exists():
        print("(no messages were recorded)", file=sys.stderr)
        return 1
    print_log(folder)
    return 0


def _record(
    run: KnownRun, recorded: RecordedRun, selection: Selection, folder: Path, arguments: argparse.Namespace
) -> None:
    """Record until the run ends, the time has passed, or a signal arrives."""
    subscriptions = [ChannelName(pair.type, ANY_VERSION, pair.topic) for pair in selection.pairs]
    stream = MessageStream(run, subscriptions, f"robbie record into {folder.name}")
    session = RecordingSession(
        recorded,
        selection,
        lambda dropped: LogWriter(
            folder.resolve(),
            Compression(arguments.compression),
            recorded.metadata(),
            Split(PART_BYTES),
            DiskBudget(folder.parent, 0),
            dropped,
            keep=recorded.keep_limits,
        ),
        LIMITS,
        total_missed=lambda: stream.missed,
        passed=stream.passed,
        log=LOG,
    )
    with signals_noted() as stopped:
        now_s = time.monotonic()
        until_s = math.inf if arguments.duration is None else now_s + arguments.duration
        count_at_s = now_s + COUNT_EVERY_S
        try:
            while not stopped and time.monotonic() < until_s:
                if received := stream.receive():
                    key = ChannelKey(received.type_name, received.version, received.topic, received.sender)
                    session.record(key, received.sequence, received.published_ns, received.data)
                if time.monotonic() > count_at_s:
                    count_at_s += COUNT_EVERY_S
                    session.count_missed()
        except RunEnded:
            print("(the run has ended)", file=sys.stderr)
        session.count_missed()
        stream.close()
        session.close()
