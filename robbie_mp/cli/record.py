"""`robbie record [PATTERN...]`: record what passes in a run that goes on already."""

import argparse
import logging
import sys
import time
from collections import defaultdict
from contextlib import closing
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from robbie_mp.attach.message_stream import MessageStream
from robbie_mp.attach.tool import Received, RunEnded
from robbie_mp.capture.queue_drops import QueueDrops, key_of_missing
from robbie_mp.capture.recorded_run import RecordedRun
from robbie_mp.capture.selection import Selection
from robbie_mp.cli import completers
from robbie_mp.cli.info import print_log
from robbie_mp.cli.parser import add_command
from robbie_mp.cli.runs import add_run_argument, choose_run
from robbie_mp.cli.signals import signals_noted
from robbie_mp.errors import RobbieError
from robbie_mp.linux.priority import lower_priority
from robbie_mp.recording.chunk_queue import BufferLimits
from robbie_mp.recording.compression import Compression
from robbie_mp.recording.disk_budget import DiskBudget
from robbie_mp.recording.format import ChannelKey
from robbie_mp.recording.log_writer import LogWriter, Split
from robbie_mp.recording.recorder import LOGGER_NICE, Recorder
from robbie_mp.run.run_directory import KnownRun
from robbie_mp.transport.records import ANY_VERSION
from robbie_mp.transport.tables import ChannelName

if TYPE_CHECKING:
    from argparse import _SubParsersAction

LIMITS = BufferLimits(chunk_bytes=1 << 20, buffer_bytes=1 << 28, close_after_s=0.5)
PART_BYTES = 1 << 30
COUNT_EVERY_S = 1.0
LOG = logging.getLogger("robbie.record")


class FolderExists(RobbieError, FileExistsError):
    """A recording would be written into a folder that is there already."""


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `record` to the commands."""
    parser = add_command(
        subparsers,
        "record",
        "record messages as they pass",
        "Record a run that goes on already into a log, until Ctrl-C or the end of the run. The robot does "
        "not wait for this: what comes faster than it is taken is dropped, and counted in the log. To record "
        "all of a run from its start, have a message logger in its profile.",
        [
            "robbie record",
            "robbie record LaserScan Odometry -o monday",
            "robbie record 'camera/*' --exclude Image --duration 60",
        ],
    )
    pattern = parser.add_argument(
        "pattern",
        nargs="*",
        metavar="PATTERN",
        help="types or topics to record, as LaserScan, sensor_msgs/* or camera/*; default: all",
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
        help="a new folder for the log; default: one named by date",
    )
    parser.add_argument(
        "--compression", choices=[str(one) for one in Compression], default="zstd", help="of the log"
    )
    parser.add_argument("--duration", metavar="S", type=float, help="end after so many seconds")
    add_run_argument(parser)
    parser.set_defaults(command=record)


def record(arguments: argparse.Namespace) -> int:
    """Record until the run or the user ends this."""
    run = choose_run(arguments.run)
    folder = arguments.output or Path(f"{datetime.now():%Y%m%d-%H%M%S}-{run.run_id}")
    if folder.exists():
        raise FolderExists(f"{folder} exists already; name a new folder with -o")
    selection = Selection.by_either(arguments.pattern or ["*"], arguments.exclude)
    logging.basicConfig(format="(%(message)s)", stream=sys.stderr)
    lower_priority(LOGGER_NICE, logging.getLogger(__name__))
    with closing(RecordedRun(run.folder)) as recorded:
        recording = _Recording(run, recorded, selection, folder, Compression(arguments.compression))
        with signals_noted() as stopped:
            until_s = None if arguments.duration is None else time.monotonic() + arguments.duration
            while not stopped and (until_s is None or time.monotonic() < until_s) and recording.step():
                pass
            recording.close()
    for pattern in selection.unmatched:
        print(f"(nothing was recorded for {pattern})", file=sys.stderr)
    if not folder.exists():
        print("(no messages were recorded)", file=sys.stderr)
        return 1
    print_log(folder)
    return 0


class _Recording:
    """Takes messages from a run and writes them into a log."""

    def __init__(
        self,
        run: KnownRun,
        recorded: RecordedRun,
        selection: Selection,
        folder: Path,
        compression: Compression,
    ):
        self._run = recorded
        self._selection = selection
        self._channels: dict[ChannelKey, int] = {}
        self._received: defaultdict[ChannelName, int] = defaultdict(int)
        wishes = [ChannelName(pair.type, ANY_VERSION, pair.topic) for pair in selection.pairs]
        self._stream = MessageStream(run, wishes, f"robbie record into {folder.name}")
        self._drops = QueueDrops(lambda: self._stream.missed, self._stream.passed)
        self._count_at_s = time.monotonic() + COUNT_EVERY_S
        self._recorder = Recorder(
            lambda dropped: LogWriter(
                folder,
                compression,
                recorded.metadata(),
                Split(PART_BYTES),
                DiskBudget(folder.parent, 0),
                dropped,
            ),
            LIMITS,
            LOG,
        )

    def step(self) -> bool:
        """Record the next message, or wait for it a little while; False if the run has ended."""
        try:
            received = self._stream.receive()
        except RunEnded:
            print("(the run has ended)", file=sys.stderr)
            return False
        if received is not None:
            self._record(received)
        if time.monotonic() > self._count_at_s:
            self._count_at_s += COUNT_EVERY_S
            self._count_drops()
        return True

    def _record(self, received: Received) -> None:
        key = ChannelKey(received.type_name, received.version, received.topic, received.sender)
        channel = self._channels.get(key)
        if channel is None:
            wanted = self._selection.wants(key.type_name, key.topic)
            schema = self._run.schema(key.type_name, key.version)
            if wanted and not schema:
                LOG.warning("%s, version %d, is recorded without a schema", key.type_name, key.version)
            channel = self._channels[key] = self._recorder.channel(key, schema) if wanted else 0
        self._received[ChannelName(*key[:3])] += 1
        if channel:
            time_ns = self._run.time_ns(received.published_ns)
            self._recorder.record(channel, received.sequence, time_ns, received.data)

    def _count_drops(self) -> None:
        for name, missing in self._drops.look(self._received).items():
            if self._selection.wants(name.type_name, name.topic):
                self._recorder.count_dropped(key_of_missing(name, self._channels), missing)

    def close(self) -> None:
        """Leave the run, and end the log."""
        self._count_drops()
        self._stream.close()
        self._recorder.close()
