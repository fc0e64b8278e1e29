"""Messages of RTPS 2.3 as bytes: headers, submessages, lists of parameters. All numbers are little endian.

Source: OMG DDSI-RTPS 2.3, https://www.omg.org/spec/DDSI-RTPS/2.3, chapters 8.3 and 9.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

VENDOR: Final = b"\0\0"
"""Unknown: no vendor's particularities are expected of this side."""
MAGIC: Final = b"RTPS\x02\x03" + VENDOR
PREFIX_BYTES, GUID_BYTES, HEADER_BYTES = 12, 16, 20
PAD, ACKNACK, HEARTBEAT, GAP, INFO_TS, INFO_DST, NACK_FRAG = 0x01, 0x06, 0x07, 0x08, 0x09, 0x0E, 0x12
DATA, DATA_FRAG = 0x15, 0x16
LITTLE_ENDIAN, FINAL, HAS_QOS, NO_TIME, HAS_DATA = 1, 2, 2, 2, 4
MAX_BITS: Final = 256
"""Most numbers in a set."""
FRAGMENT_BYTES: Final = 60_000
"""Size of the parts of messages that do not fit into one datagram."""
MIN_FRAGMENT_BYTES: Final = 256
PID_SENTINEL, PID_STATUS_INFO, PID_ENDPOINT_GUID, PID_KEY_HASH = 0x01, 0x71, 0x5A, 0x70
PID_RELATED: Final = (0x800F, 0x0083)
"""Where the identity of a request stands: FastDDS's own number, and the one of DDS-RPC."""
PARAMETERS: Final = b"\x00\x03\x00\x00"
"""Encapsulation of a list of parameters."""
_DATA = struct.Struct("<HH4s4siI")
_FRAGMENT = struct.Struct("<IHHI")
_HEARTBEAT = struct.Struct("<4s4siIiII")
_SEQUENCE = struct.Struct("<iI")
_TO_QOS, _TO_QOS_OF_FRAGMENT = 16, 28
_NO_SECONDS: Final = 0xFFFFFFFF
_MAX_SEQUENCE: Final = 1 << 62
"""No writer comes here; what is counted on from any number below still fits into 64 bits."""
Wrong = (struct.error, IndexError, ValueError)
"""What reading raises if the bytes are wrong."""


class Submessage(NamedTuple):
    """A submessage.

    Attributes:
        kind: its number, such as DATA.
        flags: its flags.
        body: what follows its header.
        sender: the participant that sent it.
        sent_ns: when its writer wrote what is in it, ns since 1970; None: the sender does not say.
    """

    kind: int
    flags: int
    body: bytes
    sender: bytes
    sent_ns: int | None = None


class Sample(NamedTuple):
    """A DATA or DATA_FRAG submessage.

    Attributes:
        reader: the reader's number in its participant; zeros: all.
        writer: the GUID of the writer.
        sequence: its number.
        parameters: the parameters before the message.
        payload: the message, or a part of it.
        fragment: number of the first part, counted from 1; 0: this is the whole message.
        fragment_bytes: size of the parts.
        size: size of the whole message, bytes.
        sent_ns: as that of a submessage.
    """

    reader: bytes
    writer: bytes
    sequence: int
    parameters: dict[int, bytes]
    payload: bytes
    fragment: int = 0
    fragment_bytes: int = 0
    size: int = 0
    sent_ns: int | None = None


def datagram(prefix: bytes, to: bytes, parts: Iterable[bytes]) -> bytes:
    """Return a message from one participant to another."""
    return MAGIC + prefix + submessage(INFO_DST, LITTLE_ENDIAN, to) + b"".join(parts)


def submessage(kind: int, flags: int, body: bytes) -> bytes:
    """Return a submessage; its length is a multiple of four."""
    body += bytes(-len(body) % 4)
    return struct.pack("<BBH", kind, flags | LITTLE_ENDIAN, len(body)) + body


def submessages(data: bytes, own_prefix: bytes) -> Iterator[Submessage]:
    """Read a message.

    Yields:
        The submessages that are meant for a participant.

    Raises:
        Wrong: it is no message of RTPS.
    """
    if data[:4] != MAGIC[:4] or len(data) < HEADER_BYTES:
        raise ValueError("no message of RTPS")
    sender, at, is_meant = data[8:HEADER_BYTES], HEADER_BYTES, True
    sent_ns = None
    while at < len(data):
        kind, flags, length = struct.unpack_from("<BBH", data, at)
        if not flags & LITTLE_ENDIAN:
            raise ValueError("not little endian")
        # A length of 0 means "up to the end", except for these two (8.3.3.2 of the standard).
        end = at + 4 + length if length or kind in (PAD, INFO_TS) else len(data)
        if end > len(data):
            raise ValueError("a submessage is too long")
        body = data[at + 4 : end]
        if kind == INFO_DST:
            is_meant = body[:PREFIX_BYTES] in (own_prefix, bytes(PREFIX_BYTES))
        elif kind == INFO_TS:
            sent_ns = None if flags & NO_TIME else _time_ns(body)
        elif is_meant:
            yield Submessage(kind, flags, body, sender, sent_ns)
        at = end


def data_parts(
    reader: bytes, writer: bytes, sequence: int, parameters: bytes, payload: bytes
) -> Iterator[bytes]:
    """Yield the submessages of a message: one, or as many as its size needs."""
    head = reader, writer, *_split(sequence)
    qos = HAS_QOS if parameters else 0
    if len(payload) <= FRAGMENT_BYTES:
        yield submessage(DATA, HAS_DATA | qos, _DATA.pack(0, _TO_QOS, *head) + parameters + payload)
        return
    for number, at in enumerate(range(0, len(payload), FRAGMENT_BYTES), 1):
        part = _FRAGMENT.pack(number, 1, FRAGMENT_BYTES, len(payload))
        body = _DATA.pack(0, _TO_QOS_OF_FRAGMENT, *head) + part + parameters
        yield submessage(DATA_FRAG, qos, body + payload[at : at + FRAGMENT_BYTES])


def sample_of(one: Submessage) -> Sample:
    """Read a DATA or DATA_FRAG submessage.

    Raises:
        Wrong: the bytes are wrong.
    """
    body = one.body
    _, to_qos, reader, writer, high, low = _DATA.unpack_from(body)
    at = 4 + to_qos
    found: dict[int, bytes] = {}
    if one.flags & HAS_QOS:
        found, at = parameters_of(body, at)
    sample = Sample(reader, one.sender + writer, _joined(high, low), found, body[at:], sent_ns=one.sent_ns)
    if one.kind == DATA:
        return sample
    number, _, size, whole = _FRAGMENT.unpack_from(body, _DATA.size)
    if size < MIN_FRAGMENT_BYTES or not number:
        raise ValueError("parts that are too small, or without a number")
    return sample._replace(fragment=number, fragment_bytes=size, size=whole)


def heartbeat(reader: bytes, writer: bytes, first: int, last: int, count: int) -> bytes:
    """Return a HEARTBEAT, which asks a reader what it misses."""
    body = _HEARTBEAT.pack(reader, writer, *_split(first), *_split(last), count)
    return submessage(HEARTBEAT, 0, body)


def heartbeat_of(one: Submessage) -> tuple[bytes, bytes, int, int]:
    """Read a HEARTBEAT: the reader, the writer's GUID, and its first and last number."""
    reader, writer, *numbers, _ = _HEARTBEAT.unpack_from(one.body)
    return reader, one.sender + writer, _joined(*numbers[:2]), _joined(*numbers[2:])


def acknack(
    reader: bytes, writer: bytes, base: int, missing: Iterable[int], count: int, *, is_final: bool = True
) -> bytes:
    """Return an ACKNACK: all before `base` is there, and these are missing; a final one needs no answer."""
    body = reader + writer + _set(base, missing) + struct.pack("<I", count)
    return submessage(ACKNACK, FINAL if is_final else 0, body)


def acknack_of(one: Submessage) -> tuple[bytes, bytes, int, list[int]]:
    """Read an ACKNACK: the reader's GUID, the writer, what comes after what is there, and what is missing."""
    base, missing = _set_of(one.body, 8)
    return one.sender + one.body[:4], one.body[4:8], base, missing


def nack_frag_of(one: Submessage) -> tuple[bytes, bytes, int]:
    """Read a NACK_FRAG: the reader's GUID, the writer, and the message of which parts are missing."""
    return one.sender + one.body[:4], one.body[4:8], _joined(*_SEQUENCE.unpack_from(one.body, 8))


def gap(reader: bytes, writer: bytes, sequence: int) -> bytes:
    """Return a GAP: a reader gets nothing under this number."""
    body = reader + writer + _SEQUENCE.pack(*_split(sequence)) + _set(sequence + 1, ())
    return submessage(GAP, 0, body)


def gap_of(one: Submessage) -> tuple[bytes, bytes, int, int, list[int]]:
    """Read a GAP: reader, the writer's GUID, the first number, the one behind the last, and single ones."""
    start = _joined(*_SEQUENCE.unpack_from(one.body, 8))
    base, single = _set_of(one.body, 16)
    return one.body[:4], one.sender + one.body[4:8], start, base, single


def related(guid: bytes, sequence: int) -> bytes:
    """Return the parameters that name a request, with the end of the list."""
    identity = guid + _SEQUENCE.pack(*_split(sequence))
    return parameter_list((number, identity) for number in PID_RELATED)


def identity_of(parameters: Mapping[int, bytes]) -> tuple[bytes, int] | None:
    """Return the GUID and number in the parameters that name a request; None if there are none."""
    found = next((parameters[one] for one in PID_RELATED if one in parameters), b"")
    if len(found) < GUID_BYTES + _SEQUENCE.size:
        return None
    return found[:GUID_BYTES], _joined(*_SEQUENCE.unpack_from(found, GUID_BYTES))


def parameter_list(parameters: Iterable[tuple[int, bytes]]) -> bytes:
    """Return a list of parameters with its end."""
    padded = ((number, value + bytes(-len(value) % 4)) for number, value in parameters)
    parts = (struct.pack("<HH", number, len(value)) + value for number, value in padded)
    return b"".join(parts) + struct.pack("<HH", PID_SENTINEL, 0)


def parameters_of(data: bytes, at: int = 0) -> tuple[dict[int, bytes], int]:
    """Read a list of parameters; return them, and where it ends. What comes several times is joined.

    Raises:
        Wrong: it has no end.
    """
    found: dict[int, bytes] = {}
    while True:
        number, length = struct.unpack_from("<HH", data, at)
        at += 4
        if number == PID_SENTINEL:
            return found, at
        if at + length > len(data):
            raise ValueError("a parameter is too long")
        found[number] = found.get(number, b"") + data[at : at + length]
        at += length


def text(value: str) -> bytes:
    """Return a text as a parameter."""
    data = value.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def text_of(value: bytes) -> str:
    """Read a text in a parameter."""
    (length,) = struct.unpack_from("<I", value)
    return value[4 : 4 + length].rstrip(b"\0").decode(errors="replace")


def _time_ns(body: bytes) -> int | None:
    """Read a time, seconds since 1970 and a fraction in units of 2**-32; None if it is invalid or zero."""
    seconds, fraction = struct.unpack_from("<II", body)
    if seconds in (0, _NO_SECONDS):
        return None
    return int(seconds) * 1_000_000_000 + (int(fraction) * 1_000_000_000 >> 32)


def _split(sequence: int) -> tuple[int, int]:
    return sequence >> 32, sequence & 0xFFFFFFFF


def _joined(high: int, low: int) -> int:
    sequence = (high << 32) + low
    if sequence > _MAX_SEQUENCE:
        raise ValueError("a number that no writer reaches")
    return sequence


def _set(base: int, numbers: Iterable[int]) -> bytes:
    bits = [number - base for number in numbers if 0 <= number - base < MAX_BITS]
    count = max(bits, default=-1) + 1
    words = [0] * ((count + 31) // 32)
    for bit in bits:
        words[bit // 32] |= 1 << (31 - bit % 32)
    return _SEQUENCE.pack(*_split(base)) + struct.pack(f"<I{len(words)}I", count, *words)


def _set_of(body: bytes, at: int) -> tuple[int, list[int]]:
    high, low, count = struct.unpack_from("<iII", body, at)
    if count > MAX_BITS:
        raise ValueError("a set has too many numbers")
    words = struct.unpack_from(f"<{(count + 31) // 32}I", body, at + 12)
    base = _joined(high, low)
    return base, [base + bit for bit in range(count) if words[bit // 32] >> (31 - bit % 32) & 1]
