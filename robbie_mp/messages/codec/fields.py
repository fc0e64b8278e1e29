"""Encodes and decodes the values of each type of field, except messages; see `messages.py`."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from robbie_mp.messages.codec.cdr import LARGEST_ALIGNMENT, padding
from robbie_mp.messages.errors import DecodeError
from robbie_mp.messages.field_types import Items, Numbers, Primitive, Several, Text, natural_default

WORD = struct.Struct("<I")
PADDED_WORDS = tuple(struct.Struct(f"<{padding(start, 4)}xI") for start in range(4))
"""A length word with the padding before it, by the position modulo 4."""


class DamageError(DecodeError):
    """Bytes do not encode what they should; `decode` says where in a message.

    Example scenarios:
      - a message was cut off
      - it is of another type

    Attributes:
        what: what is wrong.
        at: the position, in bytes.
        path: the field, which each codec that the error passes prefixes with its own part.
    """

    def __init__(self, what: str, at: int, path: str = ""):
        super().__init__(what, at, path)
        self.what = what
        self.at = at
        self.path = path

    def __str__(self) -> str:
        return self.what


class Lent:
    """Stands for the elements of an array that is filled after the message has been encoded.

    Attributes:
        array: the place of the elements, once the encoder knows it.
    """

    __slots__ = ("_count", "array")

    def __init__(self, count: int):
        self._count = count
        self.array: Any = None

    def __len__(self) -> int:
        return self._count


class Codec(ABC):
    """The encoding of one type. Positions are counted from the encapsulation.

    Attributes:
        smallest: the bytes that a value takes at least, without padding.
        sizes: the bytes with padding, by the position modulo 8; empty: they depend on the value.
    """

    smallest: int
    sizes: tuple[int, ...] = ()

    def end(self, at: int, value: Any) -> int:
        """Return where the encoding of a value ends that begins at `at`."""
        return at + self.sizes[at % LARGEST_ALIGNMENT]

    @abstractmethod
    def write(self, buffer: memoryview, at: int, value: Any) -> int:
        """Encode a value, with the padding before it, and return where it ends."""

    @abstractmethod
    def read(self, data: memoryview, at: int, into: list[Any]) -> int:
        """Append the decoded value, and return where it ends.

        Raises:
            DamageError: the bytes do not encode one.
        """


class Leaf(NamedTuple):
    """A field of a message, or of one nested in it, that has a value of its own.

    Attributes:
        name: where a message has the value, as in `pose.position.x`.
        path: the same for an error, as in `.pose.position.x`.
        type: what it holds.
    """

    name: str
    path: str
    type: Primitive | Text | Numbers | Items


class ScalarsCodec(Codec):
    """Primitives that follow one another, at once: its value is a tuple."""

    def __init__(self, leaves: Sequence[Leaf]):
        self._kinds = [leaf.type for leaf in leaves if isinstance(leaf.type, Primitive)]
        self._paths = [leaf.path for leaf in leaves]
        self._structs = [_lay_out(self._kinds, start) for start in range(LARGEST_ALIGNMENT)]
        self.sizes = tuple(each.size for each in self._structs)
        self.smallest = sum(kind.size for kind in self._kinds)

    def write(self, buffer: memoryview, at: int, value: tuple[Any, ...]) -> int:
        """Encode all of them."""
        here = self._structs[at % LARGEST_ALIGNMENT]
        here.pack_into(buffer, at, *value)
        return at + here.size

    def read(self, data: memoryview, at: int, into: list[Any]) -> int:
        """Append all of them."""
        here = self._structs[at % LARGEST_ALIGNMENT]
        if at + here.size > len(data):
            self._find_damage(data, at)
        into.extend(here.unpack_from(data, at))
        return at + here.size

    def _find_damage(self, data: memoryview, at: int) -> None:
        """Raise the error for the first one that is cut off."""
        for path, kind in zip(self._paths, self._kinds, strict=True):
            at = _expect(data, at + padding(at, kind.size), kind.size, path)


class TextCodec(Codec):
    """A string: its length with the NUL, its bytes, a NUL."""

    smallest = WORD.size

    def __init__(self, kind: Text):
        self._max_length = kind.max_length

    def end(self, at: int, value: str) -> int:
        """Return where its NUL ends."""
        octets = len(value) if value.isascii() else len(value.encode())
        return at + -at % 4 + WORD.size + octets + 1

    def write(self, buffer: memoryview, at: int, value: str) -> int:
        """Encode it."""
        octets = value.encode() + b"\0"
        start = _write_word(buffer, at, len(octets))
        stop = start + len(octets)
        buffer[start:stop] = octets
        return stop

    def read(self, data: memoryview, at: int, into: list[Any]) -> int:
        """Append it. An empty one may come without its NUL."""
        length, start = _read_word(data, at)
        stop = _expect(data, start, length)
        if length and data[stop - 1]:
            raise DamageError("a string ends with a NUL, this one does not", stop - 1)
        if self._max_length is not None and length - 1 > self._max_length:
            raise DamageError(f"{length - 1} bytes of text are more than {self._max_length}", start)
        try:
            into.append(str(data[start : stop - 1], "utf-8") if length else "")
        except UnicodeDecodeError as error:
            raise DamageError(f"not UTF-8: {error.reason}", start + error.start) from None
        return stop


class _SeveralCodec(Codec):
    """Elements of one type: a sequence begins with their number, a fixed array does not."""

    def __init__(self, kind: Several, smallest_element: int):
        self._length = kind.length
        self._max_length = kind.max_length
        self._smallest_element = smallest_element
        self.smallest = WORD.size if kind.length is None else kind.length * smallest_element

    def _write_count(self, buffer: memoryview, at: int, count: int) -> int:
        if self._length is None:
            return _write_word(buffer, at, count)
        if count != self._length:
            raise ValueError("wrong number of elements")
        return at

    def _end_of_count(self, at: int) -> int:
        return at if self._length is not None else at + -at % 4 + WORD.size

    def _read_count(self, data: memoryview, at: int) -> tuple[int, int]:
        """Return the number of elements, for which there is room, and where the first begins."""
        if self._length is not None:
            return self._length, at
        count, start = _read_word(data, at)
        if self._max_length is not None and count > self._max_length:
            raise DamageError(f"{count} elements are more than {self._max_length}", start - WORD.size)
        if count * self._smallest_element > (left := len(data) - start):
            least = f"{count} elements of at least {self._smallest_element} bytes"
            raise DamageError(f"{least}, but {left} bytes are left", start - WORD.size)
        return count, start


class NumbersCodec(_SeveralCodec):
    """Primitives in a numpy array; a decoded one is a view of the buffer."""

    def __init__(self, kind: Numbers):
        super().__init__(kind, kind.element.size)
        self._element, self._size, self._dtype = kind.element, kind.element.size, kind.element.dtype
        self._empty = natural_default(Numbers(kind.element))
        if kind.length is not None:
            self.sizes = tuple(self._span(at, kind.length)[1] - at for at in range(LARGEST_ALIGNMENT))

    def _span(self, at: int, count: int) -> tuple[int, int]:
        """Return where this number of elements begins and ends; none take no padding."""
        if count:
            at += padding(at, self._size)
        return at, at + count * self._size

    def end(self, at: int, value: Any) -> int:
        """Return where its last element ends."""
        return self._span(self._end_of_count(at), len(value))[1]

    def write(self, buffer: memoryview, at: int, value: Any) -> int:
        """Encode it, or tell what is lent where its elements will be."""
        count = len(value)
        at = self._write_count(buffer, at, count)
        start, stop = self._span(at, count)
        if start > at:
            buffer[at:start] = bytes(start - at)
        if type(value) is Lent:
            # Writable like any loan, so that the caller need not treat an empty array differently.
            empty = np.empty(0, self._dtype)
            value.array = np.frombuffer(buffer, self._dtype, count, start) if count else empty
        elif count:
            buffer[start:stop] = self._octets(value)
        return stop

    def _octets(self, value: Any) -> Any:
        if self._length is not None:  # only a fixed array may have gaps between its elements
            return value.tobytes()
        return value if self._element.code == "B" else value.data.cast("B")

    def read(self, data: memoryview, at: int, into: list[Any]) -> int:
        """Append a view of its elements."""
        count, at = self._read_count(data, at)
        if not count:
            into.append(self._empty)
            return at
        start, stop = self._span(at, count)
        _expect(data, start, stop - start)
        read = _read_truths if self._element.name == "bool" else np.frombuffer
        into.append(read(data, self._dtype, count, start))
        return stop


class ItemsCodec(_SeveralCodec):
    """A list of strings or messages."""

    def __init__(self, kind: Items, codec: Codec):
        super().__init__(kind, codec.smallest)
        self._codec = codec

    def end(self, at: int, value: Sequence[Any]) -> int:
        """Return where its last element ends."""
        at, codec = self._end_of_count(at), self._codec
        for item in value:
            at = codec.end(at, item)
        return at

    def write(self, buffer: memoryview, at: int, value: Sequence[Any]) -> int:
        """Encode its elements."""
        at, write = self._write_count(buffer, at, len(value)), self._codec.write
        for item in value:
            at = write(buffer, at, item)
        return at

    def read(self, data: memoryview, at: int, into: list[Any]) -> int:
        """Append the list."""
        count, at = self._read_count(data, at)
        items: list[Any] = []
        read = self._codec.read
        try:
            for _ in range(count):
                at = read(data, at, items)
        except DamageError as error:
            error.path = f"[{len(items)}]{error.path}"
            raise
        into.append(items)
        return at


def _lay_out(kinds: Sequence[Primitive], start: int) -> struct.Struct:
    """Return the struct of primitives that begin at a position, with the padding before each."""
    position, form = start, "<"
    for kind in kinds:
        gap = padding(position, kind.size)
        form += "x" * gap + kind.code
        position += gap + kind.size
    return struct.Struct(form)


def _write_word(buffer: memoryview, at: int, word: int) -> int:
    here = PADDED_WORDS[at % 4]
    here.pack_into(buffer, at, word)
    return at + here.size


def _read_word(data: memoryview, at: int) -> tuple[int, int]:
    """Return the next aligned length word, and where it ends."""
    at += -at % 4
    stop = _expect(data, at, WORD.size)
    return WORD.unpack_from(data, at)[0], stop


def _expect(data: memoryview, at: int, size: int, path: str = "") -> int:
    """Return where the next bytes end.

    Raises:
        DamageError: there are fewer.
    """
    if at + size > len(data):
        raise DamageError(f"needs {size} bytes, {max(len(data) - at, 0)} are left", at, path)
    return at + size


def _read_truths(data: memoryview, _dtype: object, count: int, offset: int) -> np.ndarray[Any, Any]:
    """Return `count` truth values: a view; a copy if a byte is neither 0 nor 1, which numpy cannot hold."""
    octets = np.frombuffer(data, np.uint8, count, offset)
    return octets.view(np.bool_) if octets.max() <= 1 else octets != 0
