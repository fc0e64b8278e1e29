"""`robbie export FILE OUT`: the messages of a log as CSV, numpy or PNG files, or as a bag of ROS 2."""

import argparse
import hashlib
import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from itertools import count as count_from
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO
from zipfile import ZipFile

import numpy as np

from robbie_mp.attached.views.message_text import FieldPath, flat, to_csv
from robbie_mp.base.balance import Balance
from robbie_mp.base.visible_text import one_line
from robbie_mp.cli.log_files import (
    LEFT_OUT,
    add_limit_argument,
    add_log_argument,
    add_strict_argument,
    add_topics_argument,
    print_balance,
    progress_bar,
    warn_of_unmatched,
)
from robbie_mp.cli.output import warn
from robbie_mp.cli.parser import add_command
from robbie_mp.connect.bridge.bag_export import bridge_of_log, export_bag
from robbie_mp.logs.recording.columns import Columns, columns
from robbie_mp.logs.recording.decoding import logged_type
from robbie_mp.logs.recording.errors import LogNotWritten, NotDecodable
from robbie_mp.logs.recording.png import IMAGE_TYPES, NotPng, PngMaker
from robbie_mp.logs.recording.reader import Log, LogChannel, channel_name, open_log, select
from robbie_mp.logs.recording.repair import Progress
from robbie_mp.messages import Message, Time
from robbie_mp.messages.errors import DecodeError, SchemaError

if TYPE_CHECKING:
    from argparse import _SubParsersAction

MAX_REASONS = 10
"""Different reasons that are reported for a channel."""
UNSAFE = re.compile(r"[^\w.-]|\.$")
"""Characters that are not safe in the names of files."""
MAX_NAME_BYTES = 200
"""File systems allow 255; a suffix, or the name of a picture, comes behind."""
RESERVED = {
    "CON",
    "PRN",
    "AUX",
    "NUL",
    *(f"{port}{number}" for port in ("COM", "LPT") for number in range(10)),
}
"""Names that Windows keeps for devices, with any suffix."""


def add_parser(subparsers: "_SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `export` to the commands."""
    parser = add_command(
        subparsers,
        "export",
        "write the messages of a log as CSV, numpy or PNG files, or as a ROS 2 bag",
        "Write one file per channel of a log into a folder. Each message is a row: its publishing time, its "
        "sequence number, and a column for each number and text in it. In CSV, a list is one column of JSON; "
        "in numpy files, the lists of all messages are one array, which NAME.lengths splits again. With "
        "--png, each image is a file, named after its stamp, in a folder for each channel. With --rosbag2, "
        "OUT is a bag of ROS 2 with the names that the robot's bridge gives.",
        [
            "robbie export logs/monday tables",
            "robbie export monday.mcap arrays --npz --topics odom 'laser/*'",
            "robbie export monday.mcap pictures --png --topics front/camera",
            "robbie export logs/monday monday_bag --rosbag2",
        ],
    )
    add_log_argument(parser)
    parser.add_argument(
        "folder", metavar="OUT", type=Path, help="folder to write to; created if it does not exist"
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_true", help="write CSV files (the default)")
    form.add_argument("--npz", action="store_true", help="write numpy .npz files")
    form.add_argument("--png", action="store_true", help="write images as PNG files, and nothing else")
    form.add_argument("--rosbag2", action="store_true", help="write a bag of ROS 2 (MCAP and metadata.yaml)")
    add_topics_argument(parser)
    add_limit_argument(parser)
    add_strict_argument(parser)
    parser.set_defaults(command=export)


def export(arguments: argparse.Namespace) -> int:
    """Write the files."""
    if arguments.png:
        return _export_pictures(arguments)
    if arguments.rosbag2:
        return _export_bag(arguments)
    write, suffix = (_write_npz, ".npz") if arguments.npz else (_write_csv, ".csv")
    is_whole = True
    with open_log(arguments.log, arguments.limits) as log:
        warn_of_unmatched(log.channels, arguments.topics)
        chosen, _ = select(log.channels, arguments.topics)
        for channel, name in file_names(chosen).items():
            try:
                message_type = logged_type(channel)
            except (NotDecodable, SchemaError) as error:
                warn(f"{error}; left out")
                is_whole = False
                continue
            path: Path = arguments.folder / (name + suffix)
            with progress_bar(f"writing {path}") as progress, _new_file(path) as file:
                rows = _Rows(log, channel, message_type, progress)
                write(message_type, rows, file)
            is_whole = is_whole and not rows.broken
            if rows.broken:
                warn(f"{path}: {rows.broken} messages cannot be read; left out")
        for line in log.damage:
            warn(f"{line}; only the intact part was exported")
    return 0 if is_whole else LEFT_OUT


def _export_bag(arguments: argparse.Namespace) -> int:
    """Write a bag of ROS 2."""
    folder: Path = arguments.folder
    balance = Balance(is_strict=arguments.strict)
    with open_log(arguments.log, arguments.limits) as log:
        warn_of_unmatched(log.channels, arguments.topics)
        chosen, _ = select(log.channels, arguments.topics)
        bridge = bridge_of_log(log)
        with progress_bar(f"writing {folder}") as progress:
            export_bag(log, folder, chosen, bridge.map, balance, progress)
    exit_code = print_balance(folder, balance)
    if bridge.module:
        print(f"names as the module {one_line(bridge.module)} sends them to ROS 2")
    return exit_code


def _export_pictures(arguments: argparse.Namespace) -> int:
    """Write a folder of PNG files for each channel of images."""
    maker = PngMaker()
    is_whole = True
    with open_log(arguments.log, arguments.limits) as log:
        warn_of_unmatched(log.channels, arguments.topics)
        chosen, _ = select(log.channels, arguments.topics)
        images = [channel for channel in chosen if channel.type_name in IMAGE_TYPES]
        if not images:
            warn(f"{arguments.log} has no images" + " on these topics" * bool(arguments.topics))
            return LEFT_OUT
        for channel, name in file_names(images).items():
            folder: Path = arguments.folder / name
            try:
                message_type = logged_type(channel)
            except (NotDecodable, SchemaError) as error:
                warn(f"{error}; left out")
                is_whole = False
                continue
            with progress_bar(f"writing {folder}") as progress:
                rows = _Rows(log, channel, message_type, progress)
                refused = _write_pictures(maker, rows, folder)
            for reason, count in refused.items():
                warn(f"{folder}: left out {count}: {reason}")
            if rows.broken:
                warn(f"{folder}: {rows.broken} messages cannot be read; left out")
            is_whole = is_whole and not rows.broken and not refused
        for line in log.damage:
            warn(f"{line}; only the intact part was exported")
    return 0 if is_whole else LEFT_OUT


def _write_pictures(maker: PngMaker, rows: "_Rows", folder: Path) -> Counter[str]:
    """Write the images one by one. Return how many were left out, by reason."""
    refused: Counter[str] = Counter()
    try:
        folder.mkdir(parents=True)
        for time_ns, sequence, message in rows:
            try:
                picture = maker.make(message)
            except NotPng as error:
                refused[str(error) if len(refused) < MAX_REASONS else "other reasons"] += 1
                continue
            stem = _stamp(message, time_ns)
            path = folder / f"{stem}.png"
            if path.exists():
                path = folder / f"{stem}-{sequence}.png"
            with path.open("xb") as file:
                file.write(picture)
    except OSError as error:
        raise LogNotWritten(f"{error.filename or folder} cannot be written: {error.strerror}") from error
    return refused


def _stamp(message: Message, time_ns: int) -> str:
    """Return the stamp of an image as a name that sorts by time; without a stamp, when it was published."""
    stamp: Time = message.header.stamp  # type: ignore[attr-defined]
    seconds, nanoseconds = stamp.sec, stamp.nanosec
    if not seconds and not nanoseconds:
        seconds, nanoseconds = divmod(time_ns, 10**9)
    return f"{seconds:010}.{nanoseconds:09}"


def file_names(channels: Sequence[LogChannel]) -> dict[LogChannel, str]:
    """Return a name for each channel: of its topic, and as much more as makes it the only one.

    Names that differ only in capital letters count as the same, as in the file systems of USB sticks.
    """
    names: dict[LogChannel, str] = {}
    taken: set[str] = set()
    for channel in channels:
        words = [channel_name(channel), channel.type_name.rpartition("/")[2], channel.sender, str(channel.id)]
        longer = ("-".join(words[:count]) for count in range(1, len(words) + 1))
        further = (f"{'-'.join(words)}-{number}" for number in count_from(2))
        for name in map(safe_name, chain(longer, further)):
            key = unicodedata.normalize("NFKC", name).casefold()
            if key not in taken:
                break
        taken.add(key)
        names[channel] = name
    return names


def safe_name(text: str) -> str:
    """Return a text as the name of a file, without a suffix: bounded, and with all file systems' letters.

    A name that is cut ends with a digest of the text, so that long names stay apart.
    """
    name = UNSAFE.sub("_", text)
    if len(name.encode()) > MAX_NAME_BYTES:
        digest = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()[:12]
        name = name.encode()[: MAX_NAME_BYTES - 13].decode(errors="ignore") + "-" + digest
    is_reserved = name.partition(".")[0].upper() in RESERVED or name.startswith(".")
    return f"_{name}" if is_reserved or not name else name


@contextmanager
def _new_file(path: Path) -> Iterator[BinaryIO]:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            yield file
    except OSError as error:
        raise LogNotWritten(f"{path} cannot be written: {error.strerror}") from error


class _Rows:
    """The messages of a channel: time in ns, sequence, message.

    Attributes:
        broken: how many could not be decoded.
    """

    def __init__(self, log: Log, channel: LogChannel, message_type: type[Message], progress: Progress):
        self._log = log
        self._channel = channel
        self._type = message_type
        self._progress = progress
        self.broken = 0

    def __iter__(self) -> Iterator[tuple[int, int, Message]]:
        total = self._log.counts[self._channel]
        for done, logged in enumerate(self._log.messages(channels=[self._channel]), start=1):
            self._progress(done, total)
            try:
                message = self._type.decode(logged.data)
            except DecodeError:
                self.broken += 1
            else:
                yield logged.time_ns, logged.sequence, message


def _write_csv(message_type: type[Message], rows: _Rows, file: BinaryIO) -> None:
    whole = FieldPath(message_type, "")
    headings = ["time_ns", "sequence", *(name for name, _ in flat(whole.value(message_type())))]
    file.write(f"{to_csv(headings)}\n".encode())
    for time_ns, sequence, message in rows:
        cells = [time_ns, sequence, *(cell for _, cell in flat(whole.value(message)))]
        file.write(f"{to_csv(cells)}\n".encode())


def _write_npz(message_type: type[Message], rows: _Rows, file: BinaryIO) -> None:
    found = list(rows)
    arrays: Columns = {
        "time_ns": np.array([time_ns for time_ns, _, _ in found], np.int64),
        "sequence": np.array([sequence for _, sequence, _ in found], np.uint32),
        **columns(message_type, (message for _, _, message in found)),
    }
    with ZipFile(file, "w") as archive:  # not by numpy.savez, for a column may be called `file`
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
