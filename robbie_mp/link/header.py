"""The headers of the packets that links exchange: the only place that knows how they lie in bytes.

A packet is a header and, if it is data, a part of a message as it lies in shared memory. All numbers are
little endian. Whatever arrives, `unpack` returns a packet that keeps every limit below, or None.
"""

import re
import struct
from collections.abc import Iterator
from typing import NamedTuple

from robbie_mp.link.traffic import CLASSES, TrafficClass
from robbie_mp.messages import DeclarationError, VersionError
from robbie_mp.messages.encoded import check_type

MAGIC = b"RL"
VERSION = 1
PART_BYTES = 60_000
"""Most bytes of a message in one packet: with its header, it fits into one of Zenoh's batches."""
DATAGRAM_BYTES = 900
"""Most bytes of a message in one datagram: with all headers, it fits into one frame of Ethernet or Wi-Fi."""
MAX_PARTS = 1 << 16
MAX_HEADER_BYTES = 16_384
MAX_NAME_BYTES = 96
MAX_HOPS = 8
"""Robots that a message may have passed."""
MAX_COUNTS = 512
"""Channels in one report."""
MAX_WORD = (1 << 64) - 1
ROBOT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
"""The names that a robot may have: its name is part of keys, topics and file names."""

_DATA, _REPORT, _BEAT = 1, 2, 3
LATCHED, COMPRESSED = 1, 2
_KNOWN_FLAGS = LATCHED | COMPRESSED

_START = struct.Struct("<2sBB")
_DATA_FIELDS = struct.Struct("<BBHQQQQIIqQ")
_NAMES = struct.Struct("<II")
_REPORT_FIELDS = struct.Struct("<BBQQQQH")
_COUNT = struct.Struct("<HQQ")
_BEAT_FIELDS = struct.Struct("<QQqqqQH")


class ChannelId(NamedTuple):
    """Type, version and topic of the messages of one channel, as the sending robot names them."""

    type_name: str
    version: int
    topic: str


class Data(NamedTuple):
    """Header of one part of a message; `parts` 0: of no message, a mark that only carries a sequence."""

    robot: str
    """The robot that sends it now."""
    traffic: TrafficClass
    flags: int
    channel: int
    """Number of the channel within the session."""
    session: int
    """One process of a link; the next one has another."""
    to: int
    """The session of the link that is to take it."""
    sequence: int
    """Of this packet, within session, receiver and class; the first is 1."""
    oldest: int
    """Sequence of the oldest packet of this class that the sender may still send."""
    part: int
    parts: int
    stamp_ns: int
    """When the message was published, by the clock of the robot that sends it."""
    type_hash: int
    """Of the type's schema; 0: not known."""
    name: ChannelId | None = None
    """In the first part only."""
    size: int = 0
    """Bytes of the whole message before it was compressed; in the first part only."""
    sources: tuple[str, ...] = ()
    """Robots that the message has passed, its own first; in the first part only."""


class Report(NamedTuple):
    """A receiver's account of one class of a session."""

    robot: str
    traffic: TrafficClass
    session: int
    """The receiver's own."""
    about: int
    """The session that sent the messages."""
    next: int
    """Sequence of the first packet that has not arrived, or, where none is sent again, after the newest."""
    handled: int
    """Sequence of the first packet whose message has not been handled; at most `next`."""
    counts: tuple[tuple[int, int, int], ...]
    """For each channel: its number, messages received, and messages thrown away by the receiver."""
    misses: bool = False
    """Whether packets after `next` have come, so that `next` was lost."""


class Beat(NamedTuple):
    """Says that a link lives, to one other link; carries what both need to compare their clocks."""

    robot: str
    session: int
    knows: int
    """The session of the other link from which this one has taken packets; 0: none."""
    sent_ns: int
    echo_sent_ns: int
    """When the other link sent its last beat, by its clock; 0: none has arrived."""
    echo_received_ns: int
    """When that beat arrived, by this link's clock."""
    datagrams: int = 0
    """Datagrams that this link has sent to the other one, copies too."""
    lost_permille: int = 0
    """Of the datagrams that the other link has sent lately, the part that has not arrived."""


Packet = Data | Report | Beat


def pack(packet: Packet) -> bytes:
    """Return a header as bytes.

    Args:
        packet: the header; it keeps the limits of this module.
    """
    if isinstance(packet, Data):
        fixed = _DATA_FIELDS.pack(
            packet.traffic, packet.flags, packet.channel, packet.session, packet.to, packet.sequence,
            packet.oldest, packet.part, packet.parts, packet.stamp_ns, packet.type_hash,
        )  # fmt: skip
        return _start(_DATA, packet.robot) + fixed + (_pack_names(packet) if packet.name else b"")
    if isinstance(packet, Report):
        fixed = _REPORT_FIELDS.pack(
            packet.traffic, packet.misses, packet.session, packet.about, packet.next, packet.handled,
            len(packet.counts),
        )  # fmt: skip
        return _start(_REPORT, packet.robot) + fixed + b"".join(_COUNT.pack(*one) for one in packet.counts)
    return _start(_BEAT, packet.robot) + _BEAT_FIELDS.pack(*packet[1:])


def unpack(header: bytes) -> Packet | None:
    """Return what a header says; None if no link of this version has packed it.

    Args:
        header: any bytes.
    """
    if len(header) > MAX_HEADER_BYTES:
        return None
    try:
        magic, version, kind = _START.unpack_from(header)
        if magic != MAGIC or version != VERSION:
            return None
        rest = _Reader(header, _START.size)
        robot = rest.robot()
        packet: Packet
        if kind == _DATA:
            packet = _unpack_data(robot, rest)
        elif kind == _REPORT:
            packet = _unpack_report(robot, rest)
        elif kind == _BEAT:
            packet = Beat(robot, *rest.take(_BEAT_FIELDS))
            if packet.lost_permille > 1000:
                return None
        else:
            return None
    except (_Malformed, struct.error):
        return None
    return packet if rest.is_at_end else None


class _Malformed(Exception):
    """The bytes are no header."""


class _Reader:
    """Reads one field of a header after the other; raises `_Malformed` or struct.error."""

    def __init__(self, header: bytes, at: int):
        self._header = header
        self._at = at

    @property
    def is_at_end(self) -> bool:
        return self._at == len(self._header)

    def take(self, fields: struct.Struct) -> Iterator[int]:
        values = fields.unpack_from(self._header, self._at)
        self._at += fields.size
        return iter(values)

    def text(self) -> str:
        end = self._at + 1 + _byte(self._header, self._at)
        text = self._header[self._at + 1 : end]
        if end > len(self._header) or len(text) > MAX_NAME_BYTES:
            raise _Malformed
        self._at = end
        try:
            return text.decode()
        except UnicodeDecodeError as error:
            raise _Malformed from error

    def robot(self) -> str:
        name = self.text()
        if not ROBOT_NAME.fullmatch(name):
            raise _Malformed
        return name

    def byte(self) -> int:
        value = _byte(self._header, self._at)
        self._at += 1
        return value


def _byte(header: bytes, at: int) -> int:
    if at >= len(header):
        raise _Malformed
    return header[at]


def _unpack_data(robot: str, rest: _Reader) -> Data:
    fields = tuple(rest.take(_DATA_FIELDS))
    flags, channel, session, to, sequence, oldest, part, parts, stamp_ns, type_hash = fields[1:]
    header = Data(
        robot, _traffic(fields[0]), flags, channel, session, to, sequence, oldest, part, parts,
        stamp_ns, type_hash,
    )  # fmt: skip
    is_first = header.parts > 0 and header.part == 0
    if (
        header.flags & ~_KNOWN_FLAGS
        or not 0 < header.oldest <= header.sequence
        or header.parts > MAX_PARTS
        or not (header.part < header.parts or header.part == header.parts == 0)
    ):
        raise _Malformed
    if not is_first:
        return header
    version, size = rest.take(_NAMES)
    name = ChannelId(rest.text(), version, rest.text())
    count = rest.byte()
    if not 0 < count <= MAX_HOPS:
        raise _Malformed
    sources = tuple(rest.robot() for _ in range(count))
    try:
        check_type(name.type_name, name.version)
    except (DeclarationError, VersionError) as error:
        raise _Malformed from error
    return header._replace(name=name, size=size, sources=sources)


def _unpack_report(robot: str, rest: _Reader) -> Report:
    traffic, misses, session, about, following, handled, count = rest.take(_REPORT_FIELDS)
    if count > MAX_COUNTS or misses > 1 or not 0 < handled <= following:
        raise _Malformed
    counts: list[tuple[int, int, int]] = []
    for _ in range(count):
        channel, received, refused = rest.take(_COUNT)
        counts.append((channel, received, refused))
    return Report(robot, _traffic(traffic), session, about, following, handled, tuple(counts), bool(misses))


def _traffic(number: int) -> TrafficClass:
    if number >= len(CLASSES):
        raise _Malformed
    return CLASSES[number]


def _start(kind: int, robot: str) -> bytes:
    return _START.pack(MAGIC, VERSION, kind) + _text(robot)


def _pack_names(packet: Data) -> bytes:
    assert packet.name is not None
    sources = b"".join(map(_text, packet.sources))
    names = _text(packet.name.type_name) + _text(packet.name.topic)
    return _NAMES.pack(packet.name.version, packet.size) + names + bytes([len(packet.sources)]) + sources


def _text(text: str) -> bytes:
    data = text.encode()
    return bytes([len(data)]) + data
