"""Converts encoded messages to ROS 1's serialisation and back, by a list of steps for each type.

Both are the same values in the same order. ROS 1 has neither encapsulation nor alignment, its strings end
without a NUL, its headers begin with a sequence number, and its empty messages are empty.

Source: https://wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes and
https://wiki.ros.org/ROS/Technical%20Overview#Message_serialization_and_msg_MD5_sums
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import groupby
from struct import Struct
from struct import error as StructError
from typing import TYPE_CHECKING, NamedTuple

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.ros1.definitions import HEADER, definition, md5, ros1_name
from robbie_mp.messages import DecodeError, Message
from robbie_mp.messages.codec.cdr import (
    CDR_LITTLE_ENDIAN,
    ENCAPSULATION_SIZE,
    LARGEST_ALIGNMENT,
    MAX_TRAILING_BYTES,
    padding,
)
from robbie_mp.messages.codec.fields import WORD
from robbie_mp.messages.field_types import Items, MessageLayout, Nested, Numbers, Primitive, Text
from robbie_mp.messages.message import nested

if TYPE_CHECKING:
    from typing_extensions import Buffer


class ConversionError(RobbieError, ValueError):
    """Bytes are not a message of the type that they should be."""


class Ros1Type(NamedTuple):
    """A message type as ROS 1 knows it.

        scan = ros1_type(LaserScan)
        assert scan.from_ros1(scan.to_ros1(LaserScan().encode())) == LaserScan().encode()

    Attributes:
        name: its name in ROS 1, such as `sensor_msgs/LaserScan`.
        md5: the sum by which nodes compare their definitions.
        definition: its text, with the texts of the types in it.
        message_type: its class.
    """

    name: str
    md5: str
    definition: str
    message_type: type[Message]

    def to_ros1(self, data: Buffer, sequence: int = 0) -> bytes:
        """Return ROS 1's serialisation of an encoded message.

        Args:
            data: the encoded message.
            sequence: the number in the message's header, if it has one; headers deeper inside get 0.

        Raises:
            ConversionError: the bytes do not encode a message of this type.
        """
        job = _Job(data, sequence)
        try:
            _take_encapsulation(job)
            for step in _steps_of(self.message_type):
                step.to_ros1(job)
            job.check_left(MAX_TRAILING_BYTES)
        except (ValueError, StructError) as error:
            raise self._error(job, error) from None
        return b"".join(job.parts)

    def from_ros1(self, data: Buffer) -> bytes:
        """Return the encoding of a message that ROS 1 has serialised; a module can decode it.

        Raises:
            ConversionError: the bytes are no message of this type.
        """
        job = _Job(data, 0)
        try:
            job.put(CDR_LITTLE_ENDIAN)
            for step in _steps_of(self.message_type):
                step.from_ros1(job)
            job.check_left(0)
        except (ValueError, StructError) as error:
            raise self._error(job, error) from None
        return self._checked(b"".join(job.parts))

    def _checked(self, encoded: bytes) -> bytes:
        try:
            self.message_type.decode(encoded)
        except DecodeError as error:
            raise ConversionError(str(error)) from None
        return encoded

    def _error(self, job: _Job, error: Exception) -> ConversionError:
        return ConversionError(f"{len(job.data)} bytes are no {self.name} message: {error}")


@cache
def ros1_type(message_type: type[Message]) -> Ros1Type:
    """Return a message type as ROS 1 knows it."""
    name = ros1_name(message_type.type_name)
    return Ros1Type(name, md5(message_type), definition(message_type), message_type)


class _Job:
    """The conversion of one message.

    Attributes:
        data: the given bytes.
        sequence: the number for the header of the message in ROS 1.
        read: how many bytes have been read.
        parts: the bytes made so far.
        written: how many these are, if they are an encoding.
    """

    def __init__(self, data: Buffer, sequence: int):
        self.data = memoryview(data).cast("B")
        self.sequence = sequence
        self.read = 0
        self.parts: list[bytes | memoryview] = []
        self.written = 0

    def word(self) -> int:
        """Read a length word."""
        (word,) = WORD.unpack_from(self.data, self.read)
        self.read += WORD.size
        return int(word)

    def encoded_word(self) -> int:
        """Read a length word of an encoding, which is aligned."""
        self.read += -self.read % WORD.size
        return self.word()

    def take(self, size: int) -> memoryview:
        """Read bytes.

        Raises:
            ValueError: there are fewer.
        """
        if self.read + size > len(self.data):
            raise ValueError("it ends too early")
        self.read += size
        return self.data[self.read - size : self.read]

    def put(self, part: bytes | memoryview) -> None:
        """Write bytes of an encoding."""
        self.parts.append(part)
        self.written += len(part)

    def put_encoded_word(self, word: int) -> None:
        """Write a length word of an encoding, aligned."""
        self.put(bytes(-self.written % WORD.size) + WORD.pack(word))

    def check_left(self, most: int) -> None:
        """Check that at most this number of bytes is left.

        Raises:
            ValueError: there are more.
        """
        if len(self.data) - self.read > most:
            raise ValueError("bytes behind the last field")


class _Step(ABC):
    """Converts the next bytes of a message.

    What is read in `to_ros1`, and written in `from_ros1`, is the encoding, and aligned.
    """

    @abstractmethod
    def to_ros1(self, job: _Job) -> None:
        """Read an encoding, write ROS 1's serialisation."""

    @abstractmethod
    def from_ros1(self, job: _Job) -> None:
        """Read ROS 1's serialisation, write an encoding."""


class _SequenceNumber(_Step):
    """The first field of a header in ROS 1."""

    def __init__(self, is_outermost: bool):
        self._is_outermost = is_outermost

    def to_ros1(self, job: _Job) -> None:
        job.parts.append(WORD.pack(job.sequence if self._is_outermost else 0))

    def from_ros1(self, job: _Job) -> None:
        job.take(WORD.size)


class _Filler(_Step):
    """The byte of an empty message, which ROS 1 does not have."""

    def to_ros1(self, job: _Job) -> None:
        job.take(1)

    def from_ros1(self, job: _Job) -> None:
        job.put(b"\0")


class _Fixed(NamedTuple):
    """Elements that are the same bytes in both; the alignment is the size of one."""

    alignment: int
    size: int


class _Run(_Step):
    """All that is of fixed size until something is not."""

    def __init__(self, items: Sequence[_Fixed]):
        self._structs = [_lay_out(items, start) for start in range(LARGEST_ALIGNMENT)]

    def to_ros1(self, job: _Job) -> None:
        encoded, _ = self._structs[job.read % LARGEST_ALIGNMENT]
        job.parts += encoded.unpack_from(job.data, job.read)
        job.read += encoded.size

    def from_ros1(self, job: _Job) -> None:
        encoded, serialised = self._structs[job.written % LARGEST_ALIGNMENT]
        job.put(encoded.pack(*serialised.unpack_from(job.data, job.read)))
        job.read += serialised.size


class _Text(_Step):
    """A string: in ROS 1 without the NUL, which its length does not count either."""

    def to_ros1(self, job: _Job) -> None:
        length = job.encoded_word()
        octets = job.take(length)
        if length and octets[-1]:
            raise ValueError("no NUL at the end of a string")
        job.parts += (WORD.pack(max(length - 1, 0)), octets[:-1])

    def from_ros1(self, job: _Job) -> None:
        octets = bytes(job.take(job.word()))
        if 0 in octets:
            raise ValueError("a NUL within a string")
        job.put_encoded_word(len(octets) + 1)
        job.put(octets + b"\0")


class _Sequence(_Step):
    """An array of primitives of this size, of variable length."""

    def __init__(self, size: int):
        self._size = size

    def to_ros1(self, job: _Job) -> None:
        count = job.encoded_word()
        job.parts.append(WORD.pack(count))
        if count:
            job.read += padding(job.read, self._size)
            job.parts.append(job.take(count * self._size))

    def from_ros1(self, job: _Job) -> None:
        count = job.word()
        job.put_encoded_word(count)
        if count:
            job.put(bytes(padding(job.written, self._size)))
            job.put(job.take(count * self._size))


class _List(_Step):
    """A list of strings or messages; `length` is None for one of variable length."""

    def __init__(self, length: int | None, steps: Sequence[_Step]):
        self._length = length
        self._steps = steps

    def to_ros1(self, job: _Job) -> None:
        count = self._length
        if count is None:
            count = _possible(job, job.encoded_word())
            job.parts.append(WORD.pack(count))
        for _ in range(count):
            for step in self._steps:
                step.to_ros1(job)

    def from_ros1(self, job: _Job) -> None:
        count = self._length
        if count is None:
            count = _possible(job, job.word())
            job.put_encoded_word(count)
        for _ in range(count):
            for step in self._steps:
                step.from_ros1(job)


@cache
def _steps_of(message_type: type[Message]) -> list[_Step]:
    return _steps(nested(message_type).layout, is_outermost=True)


def _steps(layout: MessageLayout, *, is_outermost: bool) -> list[_Step]:
    steps: list[_Step] = []
    for is_fixed, group in groupby(_items(layout, is_outermost), lambda item: isinstance(item, _Fixed)):
        if is_fixed:
            steps.append(_Run([item for item in group if isinstance(item, _Fixed)]))
        else:
            steps += [item for item in group if isinstance(item, _Step)]
    return steps


def _items(layout: MessageLayout, is_outermost: bool) -> Iterator[_Fixed | _Step]:
    """Yield the items of a message and of those nested in it, in order.

    `is_outermost` is whether its header, or it itself, is the one with the sequence number.
    """
    if layout.type_name == HEADER:
        yield _SequenceNumber(is_outermost)
    if not layout.fields:
        yield _Filler()
    for field in layout.fields:
        match field.type:
            case Primitive(size=size):
                yield _Fixed(size, size)
            case Numbers(element=element, length=None):
                yield _Sequence(element.size)
            case Numbers(element=element, length=int(length)):
                yield _Fixed(element.size, element.size * length)
            case Text():
                yield _Text()
            case Nested(layout=inner):
                is_header = field.name == "header" and inner.type_name == HEADER
                yield from _items(inner, is_outermost and is_header)
            case Items(element=Text(), length=count):
                yield _List(count, [_Text()])
            case Items(element=Nested(layout=inner), length=count):
                yield _List(count, _steps(inner, is_outermost=False))


def _lay_out(items: Sequence[_Fixed], start: int) -> tuple[Struct, Struct]:
    """Return the structs of a run that begins at a position: in the encoding, and in ROS 1."""
    position, encoded, serialised = start, "<", "<"
    for item in items:
        gap = padding(position, item.alignment)
        encoded += f"{gap}x{item.size}s"
        serialised += f"{item.size}s"
        position += gap + item.size
    return Struct(encoded), Struct(serialised)


def _take_encapsulation(job: _Job) -> None:
    if job.take(ENCAPSULATION_SIZE)[:2] != CDR_LITTLE_ENDIAN[:2]:
        raise ValueError("it does not begin with 00 01")


def _possible(job: _Job, count: int) -> int:
    """Return the number of elements of a list, if the message can have as many."""
    if count > len(job.data):
        raise ValueError("a list is longer than the message")
    return count
