"""Reads a log file without a summary from its start, and finds everything intact in it."""

import re
import struct
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema

from robbie_mp.logs.recording.contents import Contents, MessageBlock
from robbie_mp.logs.recording.errors import LogDamaged, LogLimitExceeded
from robbie_mp.logs.recording.limits import ReadLimits
from robbie_mp.logs.recording.mcap_records import (
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    Frame,
    chunk_data,
    content,
    frame_at,
    frames_in,
    parse,
)

FIRST_PRIVATE_OPCODE = 0x80
"""First opcode of records that any program may add."""
DATA_END_BYTES = 4
LOST_DESCRIPTIONS = "whose description is lost"
"""End of a line of `damage` that counts the messages of unknown channels."""
ROW_BYTES = 1 << 22
"""Consecutive messages outside of chunks form one block up to this size."""
WINDOW_BYTES = 1 << 20
CHUNK_HEAD = struct.Struct("<BQQQQII")
"""Opcode, length, start time, end time, size, checksum, and the length of the name of the compression."""
LONGEST_NAME_BYTES = 16
MOST_ADDED_BYTES = 256
"""Bytes behind the known fields of a chunk, for the search: newer writers may add fields to a record."""
SEARCH_BYTES, SEARCH_TIMES_SIZE = 1 << 30, 16
"""Budget for reading and decompressing what only looks like chunks: the first value in bytes, plus the
second value times the size of the file. A file can be built of such places, each nested in the previous
one."""
CHUNK_OPCODE = re.compile(rb"\x06")


def scan(file: BinaryIO, size: int, limits: ReadLimits, known: Contents | None = None) -> Contents:
    """Return the whole records of a file.

    After a damaged place, it searches for the next whole chunk, and notes the damage in `damage`.

    Args:
        file: the file.
        size: its size.
        limits: limits for the contents.
        known: the content of the summary, for messages after a damaged place.

    Raises:
        LogLimitExceeded: something in it is too large.
    """
    return _Scan(file, size, limits, known or Contents()).run()


class _Scan:
    def __init__(self, file: BinaryIO, size: int, limits: ReadLimits, known: Contents):
        self._file = file
        self._size = size
        self._limits = limits
        self._known = known
        self._found = Contents(schemas=dict(known.schemas), channels=dict(known.channels))
        self._search_bytes = SEARCH_BYTES + SEARCH_TIMES_SIZE * size
        """Bytes that may still be read and decompressed at places that only look like chunks."""
        self._row: list[Frame] = []
        """Messages outside of chunks since the last record of another kind."""
        self._row_tally = _Tally()

    def run(self) -> Contents:
        """Read the file."""
        offset = len(MAGIC)
        has_end = False
        while not has_end:
            try:
                frame = frame_at(self._file, offset, self._size)
                has_end = self._take(frame)
                offset = frame.end
            except LogLimitExceeded as error:
                raise LogLimitExceeded(f"byte {offset}: {error}") from error
            except LogDamaged as damage:
                self._end_row()
                self._found.damage.append(f"byte {offset}: {damage}")
                following = self._next_chunk(offset + 1)
                if self._search_bytes < 0:
                    self._found.damage.append(
                        "too many places look like chunks but are not; the search ended"
                    )
                if following is None:
                    break
                offset = following
        self._end_row()
        self._compare_counts()
        return self._found

    def _compare_counts(self) -> None:
        """Note messages of unknown channels, and messages that the summary counts but the file lacks."""
        expected, count = self._known.message_count, self._found.message_count
        if self._found.strangers:
            self._found.damage.append(
                f"{self._found.strangers} messages belong to channels {LOST_DESCRIPTIONS}"
            )
        elif self._known.counts and expected != count and not self._found.damage:
            self._found.damage.append(f"the summary counts {expected} messages, but there are {count}")

    def _take(self, frame: Frame) -> bool:
        """Process a record; return whether the data end with it."""
        found = self._found
        if frame.opcode == Opcode.MESSAGE:
            self._take_single(frame)
            return False
        self._end_row()
        match frame.opcode:
            case Opcode.CHUNK:
                self._take_chunk(frame)
            case Opcode.SCHEMA | Opcode.CHANNEL:
                self._describe(frame.opcode, content(self._file, frame, self._limits))
            case Opcode.HEADER if frame.start == len(MAGIC) + RECORD_HEAD.size:
                found.header = parse(Header, content(self._file, frame, self._limits))
            case Opcode.METADATA:
                found.metadata.append(parse(Metadata, content(self._file, frame, self._limits)))
            case Opcode.ATTACHMENT:
                found.attachments.append(frame)
            case Opcode.MESSAGE_INDEX if _is_message_index(content(self._file, frame, self._limits)):
                pass
            case Opcode.DATA_END if frame.length == DATA_END_BYTES:
                return True
            case opcode if opcode < FIRST_PRIVATE_OPCODE:
                raise LogDamaged(f"a record of kind {opcode} does not belong there")
        return False

    def _describe(self, opcode: int, data: bytes) -> None:
        if opcode == Opcode.SCHEMA:
            self._found.add_schema(parse(Schema, data), self._limits)
        else:
            self._found.add_channel(parse(Channel, data), self._limits)

    def _take_chunk(self, frame: Frame) -> None:
        chunk = parse(Chunk, content(self._file, frame, self._limits))
        data = chunk_data(chunk, self._limits)
        for _ in frames_in(data):  # none of the chunk counts unless all of it is whole
            pass
        tally = _Tally()
        for inner in frames_in(data):
            if inner.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._describe(inner.opcode, data[inner.start : inner.end])
            elif inner.opcode == Opcode.MESSAGE:
                if inner.length < MESSAGE_HEAD.size:
                    raise LogDamaged(f"a message record has only {inner.length} bytes")
                channel_id, _, time_ns, _ = MESSAGE_HEAD.unpack_from(data, inner.start)
                tally.add(channel_id, time_ns)
        self._found.compressions[chunk.compression] = self._found.compressions.get(chunk.compression, 0) + 1
        self._add_block(frame, tally)

    def _take_single(self, frame: Frame) -> None:
        if frame.length < MESSAGE_HEAD.size:
            raise LogDamaged(f"a message record has only {frame.length} bytes")
        self._file.seek(frame.start)
        channel_id, _, time_ns, _ = MESSAGE_HEAD.unpack(self._file.read(MESSAGE_HEAD.size))
        self._row.append(frame)
        self._row_tally.add(channel_id, time_ns)
        if frame.end - self._row[0].start > ROW_BYTES:
            self._end_row()

    def _end_row(self) -> None:
        if self._row:
            start, end = self._row[0].start - RECORD_HEAD.size, self._row[-1].end
            row = Frame(Opcode.MESSAGE, start, end - start)
            self._add_block(row, self._row_tally)
            self._row, self._row_tally = [], _Tally()

    def _add_block(self, frame: Frame, tally: "_Tally") -> None:
        found = self._found
        known = {id_: times for id_, times in tally.times.items() if id_ in found.channels}
        self._found.strangers += sum(times[0] for id_, times in tally.times.items() if id_ not in known)
        if not known:
            return
        start_ns, end_ns = (
            min(times[1] for times in known.values()),
            max(times[2] for times in known.values()),
        )
        found.start_ns = min(found.start_ns, start_ns) if found.blocks else start_ns
        found.end_ns = max(found.end_ns, end_ns)
        found.blocks.append(MessageBlock(frame, start_ns, end_ns, frozenset(known)))
        for id_, (count, _, _) in known.items():
            found.counts[id_] = found.counts.get(id_, 0) + count

    def _next_chunk(self, offset: int) -> int | None:
        """Return the offset of the next whole chunk, or None."""
        while offset < self._size and self._search_bytes >= 0:
            self._file.seek(offset)
            window = self._file.read(WINDOW_BYTES + CHUNK_HEAD.size + LONGEST_NAME_BYTES + 8)
            for opcode in CHUNK_OPCODE.finditer(window, 0, WINDOW_BYTES):
                if _may_be_chunk(window, opcode.start()) and self._is_chunk(offset + opcode.start()):
                    return offset + opcode.start()
                if self._search_bytes < 0:
                    return None
            offset += WINDOW_BYTES
        return None

    def _is_chunk(self, offset: int) -> bool:
        try:
            frame = frame_at(self._file, offset, self._size)
            chunk = parse(Chunk, content(self._file, frame, self._limits))
            self._search_bytes -= frame.length
            if chunk.uncompressed_crc == 0 or self._search_bytes < 0:
                return False
            self._search_bytes -= min(chunk.uncompressed_size, self._limits.chunk_bytes)
            data = chunk_data(chunk, self._limits)
            for _ in frames_in(data):
                pass
        except LogDamaged:
            return False
        except LogLimitExceeded as error:
            raise LogLimitExceeded(f"byte {offset}: {error}") from error
        self._search_bytes += frame.length + len(data)  # a real chunk does not use up the search budget
        return bool(data)


class _Tally:
    """Counts messages by channel, with their earliest and latest times, without keeping the messages."""

    def __init__(self) -> None:
        self.times: dict[int, list[int]] = {}
        """By channel: count, earliest time, latest time."""

    def add(self, channel_id: int, time_ns: int) -> None:
        """Count a message."""
        known = self.times.get(channel_id)
        if known is None:
            self.times[channel_id] = [1, time_ns, time_ns]
            return
        known[0] += 1
        if time_ns < known[1]:
            known[1] = time_ns
        elif time_ns > known[2]:
            known[2] = time_ns


def _may_be_chunk(window: bytes, at: int) -> bool:
    """Whether the two lengths at this place agree; by chance they hardly ever do."""
    if at + CHUNK_HEAD.size > len(window):
        return False
    _, length, _, _, _, _, name_bytes = CHUNK_HEAD.unpack_from(window, at)
    behind = at + CHUNK_HEAD.size + name_bytes
    if name_bytes > LONGEST_NAME_BYTES or behind + 8 > len(window):
        return False
    head_bytes = CHUNK_HEAD.size - RECORD_HEAD.size + name_bytes + 8
    data_bytes = int.from_bytes(window[behind : behind + 8], "little")
    return bool(0 <= length - head_bytes - data_bytes <= MOST_ADDED_BYTES)


def _is_message_index(data: bytes) -> bool:
    return len(data) >= 6 and len(data) >= 6 + int.from_bytes(data[2:6], "little")
