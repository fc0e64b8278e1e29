"""The headers of the packets that links exchange: the only place that knows how they lie in bytes.

A packet is a header and, if it is data, a part of a message as it lies in shared memory. All numbers are
little endian. Whatever arrives, `unpack` returns a packet that keeps every limit below, or None.
"""

import re
import struct
from functools import lru_cache
from typing import NamedTuple

from robbie_mp.connect.link.traffic import CLASSES, TrafficClass
from robbie_mp.messages import DeclarationError, VersionError
from robbie_mp.messages.encoded import check_type

MAGIC = b"RL"
VERSION = 5
PART_BYTES = 60_000
"""Most bytes of a message in one packet: it fits into one batch of Zenoh."""
DATAGRAM_BYTES = 900
"""Most bytes of a message in one datagram: with all headers, it fits into one frame of Ethernet or Wi-Fi."""
HEADER_BYTES = 100
"""The size that a header counts in what is under way."""
MAX_HEADER_BYTES = 16_384
MAX_NAME_BYTES = 96
MAX_COUNTS = 512
"""Channels in one report."""
MAX_WORD = (1 << 64) - 1
MAX_SEQUENCE = (1 << 62) - 1
"""Greatest number of a packet or a sending, so that what is counted from it fits into a word."""
ROBOT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")
"""The names that a robot may have: its name is part of keys, topics and file names."""

_DATA, _REPORT, _BEAT = 1, 2, 3
LATCHED, COMPRESSED = 1, 2
_KNOWN_FLAGS = LATCHED | COMPRESSED

_BEGIN = MAGIC + bytes([VERSION])
_DATA_FIELDS = struct.Struct("<3sBBBHQQQQQIIqQII")
_REPORT_FIELDS = struct.Struct("<3sBBBQQQQQH")
_COUNT = struct.Struct("<HQQ")
_BEAT_FIELDS = struct.Struct("<3sBQQqqqQH")
_KNOWN_NAMES = 1024
"""Combinations of names that are remembered, because most packets have the same ones."""


class ChannelId(NamedTuple):
    """Type, version and topic of the messages of one channel, as the sending robot names them."""

    type_name: str
    version: int
    topic: str


class DataHeader(NamedTuple):
    """Header of one part of a message, or of no message: a mark that only carries a sequence."""

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
    sending: int
    """Counts every sending of a packet of this class, those that are sent again too; the first is 1.

    At least `sequence`, because each packet is sent once or more.
    """
    start: int
    """Where this part begins in the message as it is sent."""
    whole: int
    """Bytes of the message as it is sent, compressed or not."""
    stamp_ns: int
    """When the message was published, by the clock of the robot that sends it."""
    type_hash: int
    """Hash of the type's schema; 0: not known."""
    name: ChannelId | None = None
    """In the first part only."""
    size: int = 0
    """Bytes of the whole message before it was compressed; in the first part only."""

    @property
    def is_mark(self) -> bool:
        """Whether it belongs to no message."""
        return self.name is None and not self.start


class ReceiverReport(NamedTuple):
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
    newest: int
    """The greatest `sending` that has arrived; 0: none has."""
    counts: tuple[tuple[int, int, int], ...]
    """For each channel: its number, messages received, and messages dropped by the receiver."""
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
    """The part of the datagrams lately sent by the other link that has not arrived."""


class ReceivedPacket(NamedTuple):
    """A packet from the network; nothing in it has been checked, except for its size."""

    robot: str
    """The sender, by the packet's key."""
    header: bytes
    payload: bytes
    at_ns: int
    """When it arrived, by the machine's monotonic clock."""
    is_datagram: bool
    """Whether it was sent as a datagram."""


Packet = DataHeader | ReceiverReport | Beat


def pack(packet: Packet) -> bytes:
    """Return a header as bytes.

    Args:
        packet: the header; it keeps the limits of this module.
    """
    if isinstance(packet, DataHeader):
        name = packet.name
        about = (0, 0) if name is None else (name.version, packet.size)
        return _DATA_FIELDS.pack(_BEGIN, _DATA, *packet[1:13], *about) + _packed_names(packet.robot, name)
    if isinstance(packet, ReceiverReport):
        fixed = _REPORT_FIELDS.pack(
            _BEGIN, _REPORT, packet.traffic, packet.misses, packet.session, packet.about, packet.next,
            packet.handled, packet.newest, len(packet.counts),
        )  # fmt: skip
        counts = b"".join([_COUNT.pack(*one) for one in packet.counts])
        return fixed + counts + _packed_names(packet.robot, None)
    return _BEAT_FIELDS.pack(_BEGIN, _BEAT, *packet[1:]) + _packed_names(packet.robot, None)


def unpack(header: bytes) -> Packet | None:
    """Return what a header says; None if no link of this version has packed it.

    Args:
        header: any bytes.
    """
    if not len(_BEGIN) < len(header) <= MAX_HEADER_BYTES or not header.startswith(_BEGIN):
        return None
    kind = header[len(_BEGIN)]
    try:
        if kind == _DATA:
            return _unpack_data(header)
        if kind == _REPORT:
            return _unpack_report(header)
        if kind == _BEAT:
            return _unpack_beat(header)
    except (_Malformed, struct.error):
        pass
    return None


def other_version(header: bytes) -> int:
    """Return the version of the link that packed a header; 0: it is ours, or no link packed it."""
    version = header[len(MAGIC)] if len(header) > len(_BEGIN) and header.startswith(MAGIC) else VERSION
    return 0 if version == VERSION else version


class _Malformed(Exception):
    """The bytes are no header."""


def _unpack_data(header: bytes) -> DataHeader:
    (
        _, _, traffic, flags, channel, session, to, sequence, oldest, sending, start, whole, stamp_ns,
        type_hash, version, size,
    ) = _DATA_FIELDS.unpack_from(header)  # fmt: skip
    if (
        flags & ~_KNOWN_FLAGS
        or not 0 < oldest <= sequence <= sending <= MAX_SEQUENCE
        or (start >= whole if start else whole and not version)
        or (start and version)
        or (size and not version)
    ):
        raise _Malformed
    robot, name = _names(header[_DATA_FIELDS.size :], version)
    return DataHeader(
        robot, _traffic(traffic), flags, channel, session, to, sequence, oldest, sending, start, whole,
        stamp_ns, type_hash, name, size,
    )  # fmt: skip


def _unpack_report(header: bytes) -> ReceiverReport:
    fields = _REPORT_FIELDS.unpack_from(header)
    _, _, traffic, misses, session, about, following, handled, newest, count = fields
    end = _REPORT_FIELDS.size + count * _COUNT.size
    is_possible = 0 < handled <= following <= MAX_SEQUENCE + 1 and newest <= MAX_SEQUENCE
    if count > MAX_COUNTS or misses > 1 or not is_possible or end > len(header):
        raise _Malformed
    counts = tuple(_COUNT.iter_unpack(header[_REPORT_FIELDS.size : end]))
    robot, _ = _names(header[end:], 0)
    known = _traffic(traffic)
    return ReceiverReport(robot, known, session, about, following, handled, newest, counts, bool(misses))


def _unpack_beat(header: bytes) -> Beat:
    fields = _BEAT_FIELDS.unpack_from(header)
    robot, _ = _names(header[_BEAT_FIELDS.size :], 0)
    beat = Beat(robot, *fields[2:])
    if beat.lost_permille > 1000:
        raise _Malformed
    return beat


def _traffic(number: int) -> TrafficClass:
    if number >= len(CLASSES):
        raise _Malformed
    return CLASSES[number]


# -- names: the end of each header -------------------------------------------------------------------------


@lru_cache(_KNOWN_NAMES)
def _packed_names(robot: str, name: ChannelId | None) -> bytes:
    return _text(robot) + (b"" if name is None else _text(name.type_name) + _text(name.topic))


@lru_cache(_KNOWN_NAMES)
def _names(data: bytes, version: int) -> tuple[str, ChannelId | None]:
    """Return robot and channel; with version 0, there is only the robot."""
    rest = _Reader(data)
    robot = rest.robot()
    name: ChannelId | None = None
    if version:
        name = ChannelId(rest.text(), version, rest.text())
        try:
            check_type(name.type_name, name.version)
        except (DeclarationError, VersionError) as error:
            raise _Malformed from error
    if not rest.is_at_end:
        raise _Malformed
    return robot, name


class _Reader:
    """Reads one name after the other; raises `_Malformed`."""

    def __init__(self, data: bytes):
        self._data = data
        self._at = 0

    @property
    def is_at_end(self) -> bool:
        return self._at == len(self._data)

    def byte(self) -> int:
        if self._at >= len(self._data):
            raise _Malformed
        self._at += 1
        return self._data[self._at - 1]

    def text(self) -> str:
        size = self.byte()
        text = self._data[self._at : self._at + size]
        if len(text) < size or size > MAX_NAME_BYTES:
            raise _Malformed
        self._at += size
        try:
            return text.decode()
        except UnicodeDecodeError as error:
            raise _Malformed from error

    def robot(self) -> str:
        name = self.text()
        if not ROBOT_NAME.fullmatch(name):
            raise _Malformed
        return name


def _text(text: str) -> bytes:
    data = text.encode()
    return bytes([len(data)]) + data
