"""One file of a log."""

import fcntl
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment
from typing_extensions import Self

from robbie_mp.base.linux.regular_file import open_regular
from robbie_mp.logs.recording.contents import Contents, MessageBlock
from robbie_mp.logs.recording.errors import LogDamaged, LogLimitExceeded, LogUnreadable, NotALog
from robbie_mp.logs.recording.limits import READ_LIMITS, ReadLimits
from robbie_mp.logs.recording.mcap_records import MAGIC, MESSAGE_HEAD, RECORD_HEAD, content, read_attachment
from robbie_mp.logs.recording.scan import scan
from robbie_mp.logs.recording.summary import read_summary

OTHERS = {
    b"SQLite format 3\0": "a SQLite database, perhaps a ROS 2 bag: see `robbie import-rosbag`",
    b"#ROSBAG V": "a ROS 1 bag: see `robbie import-rosbag`",
}


class PartMessage(NamedTuple):
    """A message as stored in a file."""

    channel_id: int
    sequence: int
    time_ns: int
    publish_time_ns: int
    data: bytes


class Stretch(NamedTuple):
    """Consecutive messages: the times of all of them, and those that are wanted."""

    start_ns: int
    end_ns: int
    messages: Iterable[PartMessage]


class LogPart:
    """An open MCAP file; use it as a context manager.

    Attributes:
        path: the file.
        size: size of the file in bytes.
        contents: its contents and their positions.
        is_being_written: whether a logger is writing it.
    """

    def __init__(self, path: Path, limits: ReadLimits = READ_LIMITS, *, trust_summary: bool = True):
        """Open the file, and read its summary, or the whole file if there is none.

        Args:
            path: the file.
            limits: limits for its contents.
            trust_summary: whether to use the summary; if false, the whole file is read.

        Raises:
            LogUnreadable: the file cannot be opened, or its disk fails.
            NotALog: the file is not an MCAP file.
            LogLimitExceeded: something in it is too large.
        """
        self.path = path
        self._limits = limits
        self._file = _open(path)
        try:
            try:
                self.size = self._file.seek(0, 2)
                _check_magic(path, self._file)
                self.contents = self._look(trust_summary)
            except LogLimitExceeded as error:
                raise LogLimitExceeded(f"{path}: {error}") from error
            except OSError as error:
                raise LogUnreadable(f"{path} cannot be read: {error.strerror}") from error
            self.is_being_written = not self.is_complete and _is_locked(self._file)
        except BaseException:
            self._file.close()
            raise

    @property
    def is_complete(self) -> bool:
        """Whether the file was written to its end, and no damage has been found so far."""
        return not self.contents.damage

    def _look(self, trust_summary: bool) -> Contents:
        damage: list[str] = []
        known: Contents | None = None
        try:
            known = read_summary(self._file, self.size, self._limits)
        except LogDamaged as error:
            damage.append(str(error))
        if known and trust_summary:
            return known
        found = scan(self._file, self.size, self._limits, known)
        found.damage = found.damage or damage
        return found

    def messages(
        self,
        start_ns: int | None = None,
        end_ns: int | None = None,
        channel_ids: Collection[int] | None = None,
    ) -> Iterator[PartMessage]:
        """Yield messages in file order; see `Log.messages`. Damaged ones are left out and noted."""
        wanted = None if channel_ids is None else frozenset(channel_ids)
        for block in self.contents.blocks:
            yield from self._chosen(block, start_ns, end_ns, wanted)

    def stretches(
        self,
        longest_ns: int,
        start_ns: int | None = None,
        end_ns: int | None = None,
        channel_ids: Collection[int] | None = None,
    ) -> Iterator[Stretch]:
        """Yield the same messages by chunk, with the time that all channels span; a chunk without any, too.

        Args:
            longest_ns: a chunk that spans more is read, and each message in it is a stretch.
            start_ns: as for `messages`.
            end_ns: likewise.
            channel_ids: likewise.
        """
        wanted = None if channel_ids is None else frozenset(channel_ids)
        for block in self.contents.blocks:
            if block.end_ns - block.start_ns > longest_ns:
                for one in self._chosen(block, start_ns, end_ns, None):
                    chosen = [one] if wanted is None or one.channel_id in wanted else []
                    yield Stretch(one.time_ns, one.time_ns, chosen)
            elif _may_have(block, start_ns, end_ns, None):
                chosen_in = self._chosen(block, start_ns, end_ns, wanted)
                yield Stretch(block.start_ns, block.end_ns, chosen_in)

    def _chosen(
        self, block: MessageBlock, start_ns: int | None, end_ns: int | None, wanted: frozenset[int] | None
    ) -> Iterator[PartMessage]:
        if _may_have(block, start_ns, end_ns, wanted):
            for message in self._messages_of(block):
                if (
                    (start_ns is None or message.time_ns >= start_ns)
                    and (end_ns is None or message.time_ns < end_ns)
                    and (wanted is None or message.channel_id in wanted)
                ):
                    yield message

    def blocks_backwards(self, channel_ids: Collection[int], end_ns: int) -> Iterator[list[PartMessage]]:
        """Yield the messages of each chunk, in file order, but the last chunk first. Damage is noted.

        Args:
            channel_ids: read only chunks with messages of these channels, and yield only these messages. You
                may remove ids between two chunks.
            end_ns: leave out chunks whose messages all have this log time or a later one.
        """
        for block in reversed(self.contents.blocks):
            wanted = frozenset(channel_ids)
            if wanted and _may_have(block, None, end_ns, wanted):
                yield [one for one in self._messages_of(block) if one.channel_id in wanted]

    def _messages_of(self, block: MessageBlock) -> Iterator[PartMessage]:
        try:
            yield from _messages_in(block.read(self._file, self._limits))
        except LogLimitExceeded as error:
            place = block.frame.start - RECORD_HEAD.size
            raise LogLimitExceeded(f"{self.path}: byte {place}: {error}") from error
        except (LogDamaged, OSError) as damage:  # a worn-out disk cannot read some of its blocks
            self.contents.damage.append(f"byte {block.frame.start - RECORD_HEAD.size}: {damage}")

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attachments; damaged ones are left out and noted."""
        for frame in self.contents.attachments:
            try:
                yield read_attachment(content(self._file, frame, self._limits))
            except (LogDamaged, OSError) as damage:
                self.contents.damage.append(f"byte {frame.start - RECORD_HEAD.size}: {damage}")

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


def _open(path: Path) -> BinaryIO:
    try:
        return open_regular(path)
    except OSError as error:
        raise LogUnreadable(f"{path} cannot be read: {error.strerror}") from error


def _is_locked(file: BinaryIO) -> bool:
    """Whether a process is writing the file: loggers keep it locked from before its first byte."""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    fcntl.flock(file, fcntl.LOCK_UN)
    return False


def _check_magic(path: Path, file: BinaryIO) -> None:
    file.seek(0)
    head = file.read(16)
    if not head:
        raise NotALog(f"{path} is empty")
    if not MAGIC.startswith(head[: len(MAGIC)]):
        seems = next((name for start, name in OTHERS.items() if head.startswith(start)), "")
        raise NotALog(f"{path} is no MCAP file" + (f", but {seems}" if seems else ""))


def _may_have(
    block: MessageBlock, start_ns: int | None, end_ns: int | None, channel_ids: frozenset[int] | None
) -> bool:
    if channel_ids is not None and channel_ids.isdisjoint(block.channel_ids or channel_ids):
        return False
    return (start_ns is None or block.end_ns >= start_ns) and (end_ns is None or block.start_ns < end_ns)


def _messages_in(data: bytes) -> Iterator[PartMessage]:
    offset, size = 0, len(data)
    while offset + RECORD_HEAD.size <= size:
        opcode, length = RECORD_HEAD.unpack_from(data, offset)
        start = offset + RECORD_HEAD.size
        offset = start + length
        if offset > size or (opcode == Opcode.MESSAGE and length < MESSAGE_HEAD.size):
            raise LogDamaged(f"a record of {length} bytes cannot be in a chunk of {size} bytes")
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(data, start)
            body = data[start + MESSAGE_HEAD.size : offset]
            yield PartMessage(channel_id, sequence, time_ns, publish_time_ns, body)
