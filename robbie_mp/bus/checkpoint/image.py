"""The *image* of a checkpoint: its bytes, the same in shared memory and on disk, written and read here.

    offset  bytes  meaning (little endian)
    0       8      magic, "ROBBIECP"
    8       4      version of this format
    12      4      CRC-32 of everything from offset 16 to the end
    16      8      size of the image
    24      8      size of the structure
    32      8      sequence: counts a run's checkpoints of one module
    40      8      when it was taken, ns since 1970
    48      16     0
    64             structure: JSON text (UTF-8)
                   pieces: the bytes of arrays, from the next multiple of 64 on

The structure is the state as JSON where JSON can express it: null, true, false, numbers (also NaN, Infinity
and -Infinity), strings, and lists. Everything else is an object with one key:

    {"tuple": [item, ...]}
    {"dict": [[key, value], ...]}              in order
    {"bytes": [offset, size]}
    {"array": [dtype, shape, offset]}          dtype as in numpy's array interface, as "<f4"; C order
    {"scalar": [dtype, [], offset]}            a numpy scalar

An offset counts from the beginning of the pieces and is a multiple of 64.
"""

import json
import re
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.bus.checkpoint.errors import CheckpointDamaged, CheckpointTooNew, UnsupportedState

VERSION = 1
MAGIC = b"ROBBIECP"
HEADER = struct.Struct("<8sIIQQQQ16x")
CRC_BEGIN = 16
ALIGNMENT = 64
DTYPE = re.compile(r"[<>|][biufcSUmM][1-9][0-9]{0,8}(\[[0-9]*[A-Za-z]{1,2}(/[0-9]+)?\])?")
"""Numbers, times and strings of fixed length, in either byte order; no Python objects and no records."""


@dataclass(frozen=True)
class ImageHeader:
    """The header of an image."""

    size: int
    structure_size: int
    sequence: int
    taken_ns: int


def aligned(size: int) -> int:
    """Round a size up to a multiple of `ALIGNMENT`, where a piece may begin."""
    return -(-size // ALIGNMENT) * ALIGNMENT


def write_header(image: memoryview, header: ImageHeader) -> None:
    """Write the header after all other bytes of an image; its CRC makes the image valid."""
    fields = (header.size, header.structure_size, header.sequence, header.taken_ns)
    HEADER.pack_into(image, 0, MAGIC, VERSION, 0, *fields)
    crc = zlib.crc32(image[CRC_BEGIN : header.size])
    HEADER.pack_into(image, 0, MAGIC, VERSION, crc, *fields)


def read_header(image: memoryview, available: int) -> ImageHeader:
    """Read the header of an image and check it, but not the CRC.

    Args:
        image: at least the header.
        available: number of bytes there are; bytes after the image are ignored.

    Raises:
        CheckpointDamaged: this is not an image, or its end is missing.
        CheckpointTooNew: this version does not know the format.
    """
    if len(image) < HEADER.size or image[: len(MAGIC)] != MAGIC:
        raise CheckpointDamaged(f"these {available} bytes are not a checkpoint: the magic number is missing")
    _, version, _, *fields = HEADER.unpack_from(image)
    if version > VERSION:
        raise CheckpointTooNew(
            f"the checkpoint has format {version}; this Robbie-MP reads formats up to {VERSION}"
        )
    header = ImageHeader(*fields)
    if version < 1 or not HEADER.size <= header.size <= available:
        raise CheckpointDamaged(
            f"a checkpoint of {header.size} bytes, format {version}, in {available} bytes"
        )
    if aligned(HEADER.size + header.structure_size) > header.size:
        raise CheckpointDamaged(f"a structure of {header.structure_size} bytes in {header.size} bytes")
    return header


def check_crc(image: memoryview, header: ImageHeader) -> None:
    """Check that an image holds what was written.

    Raises:
        CheckpointDamaged: the CRC differs.
    """
    written = int(HEADER.unpack_from(image)[2])
    found = zlib.crc32(image[CRC_BEGIN : header.size])
    if found != written:
        raise CheckpointDamaged(f"the checkpoint's CRC is {found:08x}, {written:08x} was written")


MAX_DEPTH = 100
SCALARS = frozenset([bool, int, float, str, type(None)])
Piece = bytes | NDArray[Any]


@dataclass(frozen=True)
class ImageLayout:
    """The position of each part of a state in its image; the arrays are not copied yet."""

    structure: bytes
    pieces: list[tuple[int, Piece]]
    size: int
    """Size of the whole image in bytes."""

    def write(self, image: memoryview, sequence: int, taken_ns: int) -> None:
        """Write an image.

        Args:
            image: at least `size` bytes.
            sequence: the number of this checkpoint of its module.
            taken_ns: when it was taken, ns since 1970.
        """
        begin = aligned(HEADER.size + len(self.structure))
        _put(image, HEADER.size, self.structure)
        for offset, piece in self.pieces:
            _put(image, begin + offset, piece)
        write_header(image, ImageHeader(self.size, len(self.structure), sequence, taken_ns))


def lay_out(state: object) -> ImageLayout:
    """Plan the image of a state.

    Args:
        state: None, bool, int, float, str, bytes and numpy arrays and numbers, in lists, tuples and dicts.

    Raises:
        UnsupportedState: the state contains something else; the text says where.
    """
    collector = _Collector()
    node = collector.node(state, "state", 0)
    try:
        # UTF-8 has no lone surrogates, and Python limits the digits of an integer's text.
        structure = json.dumps(node, ensure_ascii=False, separators=(",", ":")).encode()
    except ValueError as error:
        raise UnsupportedState(
            f"the state holds a string or a number that cannot be stored: {error}"
        ) from error
    size = aligned(HEADER.size + len(structure)) + collector.size
    return ImageLayout(structure, collector.pieces, size)


def encode(state: object, sequence: int = 1, taken_ns: int = 0) -> bytes:
    """Return the image of a state.

    Raises:
        UnsupportedState: as `lay_out`.
    """
    layout = lay_out(state)
    image = bytearray(layout.size)
    layout.write(memoryview(image), sequence, taken_ns)
    return bytes(image)


class _Collector:
    """Turns values into nodes of the structure and gathers the pieces."""

    def __init__(self) -> None:
        self.pieces: list[tuple[int, Piece]] = []
        self.size = 0

    def node(self, value: Any, where: str, depth: int) -> object:
        kind = type(value)
        if kind in SCALARS:
            return value
        if depth > MAX_DEPTH:
            raise UnsupportedState(
                f"{where:.60}… is nested deeper than {MAX_DEPTH} levels, or contains itself"
            )
        if kind is list:
            return self._items(value, where, depth)
        if kind is tuple:
            return {"tuple": self._items(value, where, depth)}
        if kind is dict:
            return {"dict": [self._pair(key, item, where, depth) for key, item in value.items()]}
        return self._leaf(value, where)

    def _leaf(self, value: Any, where: str) -> object:
        kind = type(value)
        if kind is bytes:
            return {"bytes": [self._place(value, len(value)), len(value)]}
        if kind is np.ndarray:
            return {"array": self._array(value, where)}
        if isinstance(value, np.generic):
            return {"scalar": self._array(np.asarray(value), where)}
        raise UnsupportedState(
            f"{where} is a {kind.__module__}.{kind.__qualname__}; a checkpoint holds None, bool, int, float, "
            "str, bytes and numpy arrays, in lists, tuples and dicts: convert it, as with dict(…) or int(…)"
        )

    def _items(self, items: list[Any] | tuple[Any, ...], where: str, depth: int) -> list[object]:
        return [
            item if type(item) in SCALARS else self.node(item, f"{where}[{index}]", depth + 1)
            for index, item in enumerate(items)
        ]

    def _pair(self, key: Any, item: Any, where: str, depth: int) -> list[object]:
        plain_key = key if type(key) in SCALARS else self.node(key, f"a key of {where}", depth + 1)
        return [plain_key, self.node(item, f"{where}[{key!r:.60}]", depth + 1)]

    def _array(self, array: NDArray[Any], where: str) -> list[object]:
        if not DTYPE.fullmatch(array.dtype.str):
            raise UnsupportedState(
                f"{where} is an array of {array.dtype}; only numbers, times and strings can be stored"
            )
        return [array.dtype.str, list(array.shape), self._place(array, array.nbytes)]

    def _place(self, piece: Piece, size: int) -> int:
        offset = self.size
        self.pieces.append((offset, piece))
        self.size += aligned(size)
        return offset


def _put(image: memoryview, begin: int, piece: Piece) -> None:
    """Write a piece, then zeros up to the next multiple of `ALIGNMENT`."""
    if isinstance(piece, bytes):
        end = begin + len(piece)
        image[begin:end] = piece
    else:
        end = begin + piece.nbytes
        np.copyto(np.ndarray(piece.shape, piece.dtype, image, begin), piece, casting="no")
    image[end : aligned(end)] = bytes(aligned(end) - end)


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint as read."""

    state: Any
    """Its arrays are writable copies."""
    sequence: int
    taken_ns: int
    """When it was taken, ns since 1970."""


def decode(image: memoryview | bytes) -> Checkpoint:
    """Read an image; bytes after it are ignored.

    Raises:
        CheckpointDamaged: the image is not as it was written.
        CheckpointTooNew: this version does not know the format.
    """
    view = memoryview(image)
    header = read_header(view, len(view))
    check_crc(view, header)
    structure_end = HEADER.size + header.structure_size
    try:
        node = json.loads(bytes(view[HEADER.size : structure_end]))
        state = _Reader(view[aligned(structure_end) : header.size]).value(node)
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError) as error:
        raise CheckpointDamaged(f"the checkpoint's structure is invalid: {error}") from error
    return Checkpoint(state, header.sequence, header.taken_ns)


class _Reader:
    """Turns nodes of the structure back into values; an invalid node raises some built-in error."""

    def __init__(self, pieces: memoryview):
        self._pieces = pieces
        self._unread = len(pieces)

    def value(self, node: Any) -> Any:
        if type(node) is list:
            return [self.value(item) for item in node]
        if type(node) is not dict:
            return node
        ((tag, body),) = node.items()
        return KINDS[tag](self, body)

    def read_tuple(self, items: list[Any]) -> tuple[Any, ...]:
        return tuple(self.value(item) for item in items)

    def read_dict(self, pairs: list[Any]) -> dict[Any, Any]:
        return {self.value(key): self.value(item) for key, item in pairs}

    def read_bytes(self, body: list[Any]) -> bytes:
        offset, size = body
        return bytes(self._piece(offset, size))

    def read_scalar(self, body: list[Any]) -> Any:
        return self.read_array(body)[()]

    def read_array(self, body: list[Any]) -> NDArray[Any]:
        dtype_name, shape, offset = body
        if not DTYPE.fullmatch(dtype_name) or not all(type(length) is int for length in shape):
            raise ValueError(f"an array of {dtype_name!r:.40} and shape {shape!r:.40}")
        dtype = np.dtype(dtype_name)
        size = dtype.itemsize
        for length in shape:
            size *= length
        return np.ndarray(shape, dtype, self._piece(offset, size)).copy()

    def _piece(self, offset: int, size: int) -> memoryview:
        """Return the bytes of a piece; the total size of all pieces read is bounded by the image's size."""
        self._unread -= size
        inside = size >= 0 and offset >= 0 and offset + size <= len(self._pieces)
        if not inside or offset % ALIGNMENT or self._unread < 0:
            raise ValueError(f"{size} bytes at {offset} of {len(self._pieces)}")
        return self._pieces[offset : offset + size]


KINDS = {
    "tuple": _Reader.read_tuple,
    "dict": _Reader.read_dict,
    "bytes": _Reader.read_bytes,
    "array": _Reader.read_array,
    "scalar": _Reader.read_scalar,
}
"""How to read each kind of node that is not plain JSON."""
