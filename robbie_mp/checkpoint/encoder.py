"""From a state to the bytes of its checkpoint, each array copied once: to where it is kept."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.checkpoint.errors import UnsupportedState
from robbie_mp.checkpoint.image import DTYPE, HEADER, Header, aligned, write_header

MAX_DEPTH = 100
SCALARS = frozenset([bool, int, float, str, type(None)])
Piece = bytes | NDArray[Any]


@dataclass(frozen=True)
class Layout:
    """Where everything of a state goes; the arrays are still the state's own."""

    structure: bytes
    pieces: list[tuple[int, Piece]]
    size: int
    """Of the whole image, in bytes."""

    def write(self, image: memoryview, sequence: int, taken_ns: int) -> None:
        """Write an image.

        Args:
            image: at least `size` bytes.
            sequence: which checkpoint of its module this is.
            taken_ns: when, ns since 1970.
        """
        begin = aligned(HEADER.size + len(self.structure))
        _put(image, HEADER.size, self.structure)
        for offset, piece in self.pieces:
            _put(image, begin + offset, piece)
        write_header(image, Header(self.size, len(self.structure), sequence, taken_ns))


def lay_out(state: object) -> Layout:
    """Plan the image of a state.

    Args:
        state: None, bool, int, float, str, bytes and numpy arrays and numbers, in lists, tuples and dicts.

    Raises:
        UnsupportedState: there is something else in it; the text says where.
    """
    collector = _Collector()
    node = collector.node(state, "state", 0)
    try:
        # Standard JSON has no surrogates, and Python no decimal numbers beyond some thousand digits.
        structure = json.dumps(node, ensure_ascii=False, separators=(",", ":")).encode()
    except ValueError as error:
        raise UnsupportedState(f"the state holds a text or a number that cannot be kept: {error}") from error
    size = aligned(HEADER.size + len(structure)) + collector.size
    return Layout(structure, collector.pieces, size)


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
            raise UnsupportedState(f"{where:.60}… lies deeper than {MAX_DEPTH} levels, or contains itself")
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
            "str, bytes and numpy arrays, in lists, tuples and dicts: convert it, as by dict(…) or int(…)"
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
            raise UnsupportedState(f"{where} is an array of {array.dtype}; there may be numbers and texts")
        return [array.dtype.str, list(array.shape), self._place(array, array.nbytes)]

    def _place(self, piece: Piece, size: int) -> int:
        offset = self.size
        self.pieces.append((offset, piece))
        self.size += aligned(size)
        return offset


def _put(image: memoryview, begin: int, piece: Piece) -> None:
    """Write a piece, and zeros up to where the next one may begin."""
    if isinstance(piece, bytes):
        end = begin + len(piece)
        image[begin:end] = piece
    else:
        end = begin + piece.nbytes
        np.copyto(np.ndarray(piece.shape, piece.dtype, image, begin), piece, casting="no")
    image[end : aligned(end)] = bytes(aligned(end) - end)
