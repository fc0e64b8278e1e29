"""The forms in which `robbie export` writes messages, and the new files, of which a failure leaves none."""

import contextlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import BinaryIO, TypeVar
from zipfile import ZipFile

import numpy as np

from robbie_mp.attached.views.message_text import to_csv
from robbie_mp.base.balance import Balance
from robbie_mp.cli.export_table import ChannelTable
from robbie_mp.cli.file_names import safe_name
from robbie_mp.logs.recording.columns import Columns, columns
from robbie_mp.logs.recording.errors import LogError, LogNotWritten
from robbie_mp.logs.recording.parquet import ParquetLibrary, ParquetTable
from robbie_mp.logs.recording.ply import CLOUD_TYPES, ply
from robbie_mp.logs.recording.png import IMAGE_TYPES, PngMaker
from robbie_mp.logs.recording.reader import Log, LogChannel, channel_name
from robbie_mp.logs.recording.trajectory import TRAJECTORY_TYPES, TUM_HEADING, StampedPose, poses, stamp_ns
from robbie_mp.messages import Message, stock_registry
from robbie_mp.messages.errors import DecodeError
from robbie_mp.messages.units import units

Made = TypeVar("Made")
ARRAYS_SUFFIX = ".arrays"
"""Of the folder beside a table, in which its arrays are."""
MAX_TIME_NS = (1 << 63) - 1
"""The latest time that an int64 can have; a damaged or foreign log may claim a later one."""
MAX_TRAJECTORIES = 200
"""Pairs of frames of a channel, each with a file that is open."""


class NewFiles:
    """New files in a folder. `new_files` removes them if something fails."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._made: list[Path] = []

    @contextmanager
    def open(self, name: str) -> Iterator[BinaryIO]:
        """Make a file; missing folders are made, too.

        Raises:
            LogNotWritten: it exists, or cannot be written.
        """
        path = self.folder / name
        try:
            self._make_folder(path.parent)
            with path.open("xb") as file:
                self._made.append(path)
                yield file
        except OSError as error:
            if isinstance(error, LogError):
                raise
            raise LogNotWritten(f"{path} cannot be written: {error.strerror}") from error

    def _make_folder(self, folder: Path) -> None:
        missing = [one for one in (folder, *folder.parents) if not one.exists()]
        for one in reversed(missing):
            one.mkdir()
            self._made.append(one)
        folder.mkdir(exist_ok=True)  # refuses a file of that name

    def make_folder(self, name: str) -> None:
        """Make a folder.

        Raises:
            LogNotWritten: it exists, or cannot be made.
        """
        path = self.folder / name
        try:
            self._make_folder(path.parent)
            path.mkdir()
        except OSError as error:
            raise LogNotWritten(f"{path} cannot be written: {error.strerror}") from error
        self._made.append(path)

    def has(self, name: str) -> bool:
        """Return whether there is a file of that name."""
        return (self.folder / name).exists()

    def remove(self) -> None:
        """Remove what was made."""
        for path in reversed(self._made):
            with contextlib.suppress(OSError):
                path.rmdir() if path.is_dir() else path.unlink()


class MeasuredFiles(NewFiles):
    """Files that are only measured.

    Attributes:
        size: bytes in all of them.
    """

    size = 0

    def __init__(self) -> None:
        super().__init__(Path())

    @contextmanager
    def open(self, name: str) -> Iterator[BinaryIO]:
        """Yield a file in memory."""
        file = BytesIO()
        yield file
        self.size += file.getbuffer().nbytes

    def make_folder(self, name: str) -> None:
        """Make none."""

    def has(self, name: str) -> bool:
        """Return False."""
        return False


@contextmanager
def new_files(folder: Path) -> Iterator[NewFiles]:
    """Yield what makes new files in a folder, and remove them if the context ends with an error."""
    files = NewFiles(folder)
    try:
        yield files
    except BaseException:
        files.remove()
        raise


class Rows:
    """The messages of a channel: time in ns, sequence, message. Those that cannot be written are left out.

    Args:
        log: the log.
        channel: the channel.
        message_type: of its messages.
        balance: counts what is left out. The caller counts each message that it has written as used.
        progress: called for each message.
        most: read the first ones only; None: all.

    Attributes:
        message_bytes: bytes of the last message.
    """

    message_bytes = 0

    def __init__(
        self,
        log: Log,
        channel: LogChannel,
        message_type: type[Message],
        balance: Balance,
        progress: Callable[[], None],
        most: int | None = None,
    ):
        self.message_type = message_type
        self.channel = channel
        self.name = repr(channel_name(channel))
        self.balance = balance
        self._log = log
        self._progress = progress
        self._most = most

    def __iter__(self) -> Iterator[tuple[int, int, Message]]:
        for logged in islice(self._log.messages(channels=[self.channel]), self._most):
            self._progress()
            if logged.time_ns > MAX_TIME_NS:
                self.balance.leave_out(f"messages of {self.name} whose time is after the year 2262")
                continue
            try:
                message = self.message_type.decode(logged.data)
            except DecodeError:
                self.balance.leave_out(f"messages of {self.name} that do not encode their type")
            else:
                self.message_bytes = len(logged.data)
                yield logged.time_ns, logged.sequence, message

    def made(self, make: Callable[[Message, int], Made]) -> Iterator[tuple[int, int, Message, Made]]:
        """Yield with each message what is made of it and its time; leave out messages of which that fails."""
        for time_ns, sequence, message in self:
            try:
                found = make(message, time_ns)
            except LogError as error:
                self.balance.leave_out(f"messages of {self.name}: {error}")
            else:
                yield time_ns, sequence, message, found
                self.balance.use()


@dataclass(frozen=True)
class Form:
    """A form in which messages are written.

    Attributes:
        name: what is written.
        suffix: of the file of a channel; '' for a folder.
        write: writes the messages of a channel to new files; the last argument is the name.
        types: the types that it can write; () for all.
    """

    name: str
    suffix: str
    write: Callable[[Rows, NewFiles, str], None]
    types: tuple[str, ...] = ()

    def takes(self, channel: LogChannel) -> bool:
        """Return whether it can write messages of a channel."""
        return not self.types or channel.type_name in self.types


def _write_csv(rows: Rows, files: NewFiles, name: str) -> None:
    unit = units(rows.message_type, rows.channel.schema or "", stock_registry())
    folder = name.removesuffix(".csv") + ARRAYS_SUFFIX
    with ExitStack() as opened:
        file = opened.enter_context(files.open(name))

        def open_array(field: str) -> BinaryIO:
            return opened.enter_context(files.open(f"{folder}/{safe_name(field)}.npy"))

        table = ChannelTable(rows.message_type, open_array)
        headings = [f"{one} [{unit[field]}]" if field in unit else one for one, field in table.names]
        file.write(f"{to_csv(['time_ns', 'sequence', *headings])}\n".encode())
        for time_ns, sequence, message in rows:
            file.write(f"{to_csv([time_ns, sequence, *table.row(message)])}\n".encode())
            rows.balance.use()
        table.finish()


def _write_npz(rows: Rows, files: NewFiles, name: str) -> None:
    found = list(rows)
    arrays: Columns = {
        "time_ns": np.array([time_ns for time_ns, _, _ in found], np.int64),
        "sequence": np.array([sequence for _, sequence, _ in found], np.uint32),
        **columns(rows.message_type, (message for _, _, message in found)),
    }
    with files.open(name) as file, ZipFile(file, "w") as archive:
        for column, array in arrays.items():  # not by numpy.savez, for a column may be called `file`
            with archive.open(f"{column}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
    rows.balance.use(len(found))


def parquet() -> Form:
    """Return the form for Parquet files.

    Raises:
        NotParquet: Apache Arrow is not installed.
    """
    library = ParquetLibrary()

    def write(rows: Rows, files: NewFiles, name: str) -> None:
        unit = units(rows.message_type, rows.channel.schema or "", stock_registry())
        with files.open(name) as file, ParquetTable(library, rows.message_type, file, unit) as table:
            for time_ns, sequence, message in rows:
                table.add(time_ns, sequence, message, rows.message_bytes)
                rows.balance.use()

    return Form("messages", ".parquet", write)


def pictures() -> Form:
    """Return the form for images.

    Raises:
        NotPng: OpenCV is not installed.
    """
    maker = PngMaker()
    return Form("images", "", lambda *where: _write_each(maker.make, ".png", *where), IMAGE_TYPES)


def _write_each(
    make: Callable[[Message], bytes], suffix: str, rows: Rows, files: NewFiles, folder: str
) -> None:
    """Write a file for each message into a folder that is new."""
    files.make_folder(folder)
    for time_ns, sequence, message, content in rows.made(lambda message, _: make(message)):
        stem = f"{folder}/{_stamp(message, time_ns)}"
        name = f"{stem}-{sequence}{suffix}" if files.has(stem + suffix) else stem + suffix
        with files.open(name) as file:
            file.write(content)


def _stamp(message: Message, time_ns: int) -> str:
    """Return the stamp of a message as a name that sorts by time; without a stamp, when it was published."""
    seconds, nanoseconds = divmod(stamp_ns(message, time_ns), 10**9)
    return f"{seconds:010}.{nanoseconds:09}"


class _Trajectories:
    """The files of the trajectories of a channel: one, or of transforms one for each pair of frames."""

    def __init__(self, files: NewFiles, name: str, heading: str, opened: ExitStack):
        self._files, self._name, self._heading, self._opened = files, name, heading, opened
        self._of: dict[str, BinaryIO] = {}

    def file(self, frames: str) -> BinaryIO:
        """Return the file of a pair of frames."""
        if frames not in self._of:
            if len(self._of) == MAX_TRAJECTORIES:
                raise LogError(f"more than {MAX_TRAJECTORIES} pairs of frames")
            stem, _, suffix = self._name.rpartition(".")
            name = f"{safe_name(f'{stem}-{frames}' if frames else stem)}.{suffix}"
            self._of[frames] = self._opened.enter_context(self._files.open(name))
            self._of[frames].write(self._heading.encode())
        return self._of[frames]


def _write_trajectories(
    line: Callable[[StampedPose], str], heading: str, rows: Rows, files: NewFiles, name: str
) -> None:
    with ExitStack() as opened:
        made = _Trajectories(files, name, heading, opened)

        def lines(message: Message, time_ns: int) -> list[tuple[BinaryIO, str]]:
            return [(made.file(pose.frames), line(pose)) for pose in list(poses(message, time_ns))]

        for *_, found in rows.made(lines):
            for file, text in found:
                file.write(text.encode())


CSV = Form("messages", ".csv", _write_csv)
NPZ = Form("messages", ".npz", _write_npz)
PLY = Form("point clouds or scans", "", lambda *where: _write_each(ply, ".ply", *where), CLOUD_TYPES)
TRAJECTORIES = {
    "tum": Form(
        "poses",
        ".tum",
        lambda *where: _write_trajectories(StampedPose.tum, TUM_HEADING, *where),
        TRAJECTORY_TYPES,
    ),
    "kitti": Form(
        "poses", ".kitti", lambda *where: _write_trajectories(StampedPose.kitti, "", *where), TRAJECTORY_TYPES
    ),
}
