"""From the bytes of a checkpoint, whatever they hold, to the state or to an error of ours."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.checkpoint.errors import CheckpointDamaged
from robbie_mp.checkpoint.image import ALIGNMENT, DTYPE, HEADER, aligned, check_crc, read_header


@dataclass(frozen=True)
class Checkpoint:
    """A checkpoint that was read."""

    state: Any
    """Its arrays are writable copies of their own."""
    sequence: int
    taken_ns: int
    """When it was taken, ns since 1970."""


def decode(image: memoryview | bytes) -> Checkpoint:
    """Read an image; bytes beyond it do not matter.

    Raises:
        CheckpointDamaged: this is not what was written.
        CheckpointTooNew: it has a form that this version does not know.
    """
    view = memoryview(image)
    header = read_header(view, len(view))
    check_crc(view, header)
    structure_end = HEADER.size + header.structure_size
    try:
        node = json.loads(bytes(view[HEADER.size : structure_end]))
        state = _Reader(view[aligned(structure_end) : header.size]).value(node)
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError) as error:
        raise CheckpointDamaged(f"the checkpoint's structure makes no sense: {error}") from error
    return Checkpoint(state, header.sequence, header.taken_ns)


class _Reader:
    """Turns nodes of the structure back into values; what is not one raises some built-in error."""

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
        """Return the bytes of a piece; all pieces together are no more than there is."""
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
"""How each kind of node is read that is not just JSON."""
