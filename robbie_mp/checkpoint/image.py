"""The bytes of a checkpoint, the same in shared memory and on disk: its *image*.

    offset  bytes  meaning (little endian)
    0       8      magic, "ROBBIECP"
    8       4      version of this form
    12      4      CRC-32 of everything from offset 16 to the end
    16      8      size of the image
    24      8      size of the structure
    32      8      sequence: counts a run's checkpoints of one module
    40      8      when it was taken, ns since 1970
    48      16     0
    64             structure: JSON text (UTF-8)
                   pieces: the bytes of arrays, from the next multiple of 64 on

The structure is the state itself, where JSON can say it: null, true, false, numbers (also NaN, Infinity and
-Infinity), strings, and lists. Everything else is an object with one key:

    {"tuple": [item, ...]}
    {"dict": [[key, value], ...]}              in order
    {"bytes": [offset, size]}
    {"array": [dtype, shape, offset]}          dtype as in numpy's array interface, as "<f4"; C order
    {"scalar": [dtype, [], offset]}            a number of numpy

An offset counts from the beginning of the pieces and is a multiple of 64.
"""

import re
import struct
import zlib
from dataclasses import dataclass

from robbie_mp.checkpoint.errors import CheckpointDamaged, CheckpointTooNew

VERSION = 1
MAGIC = b"ROBBIECP"
HEADER = struct.Struct("<8sIIQQQQ16x")
CRC_BEGIN = 16
ALIGNMENT = 64
DTYPE = re.compile(r"[<>|][biufcSUmM][1-9][0-9]{0,8}(\[[0-9]*[A-Za-z]{1,2}(/[0-9]+)?\])?")
"""Numbers, times, and texts of fixed length, of either byte order; no Python objects and no records."""


@dataclass(frozen=True)
class Header:
    """What an image says of itself."""

    size: int
    structure_size: int
    sequence: int
    taken_ns: int


def aligned(size: int) -> int:
    """Round a size up to where a piece may begin."""
    return -(-size // ALIGNMENT) * ALIGNMENT


def write_header(image: memoryview, header: Header) -> None:
    """Write the header of an image whose other bytes are in place; its CRC makes it valid."""
    fields = (header.size, header.structure_size, header.sequence, header.taken_ns)
    HEADER.pack_into(image, 0, MAGIC, VERSION, 0, *fields)
    crc = zlib.crc32(image[CRC_BEGIN : header.size])
    HEADER.pack_into(image, 0, MAGIC, VERSION, crc, *fields)


def read_header(image: memoryview, available: int) -> Header:
    """Read the header of an image and check it, but not the CRC.

    Args:
        image: at least its header.
        available: how many bytes there are; bytes beyond the image do not matter.

    Raises:
        CheckpointDamaged: this is no image, or its end is missing.
        CheckpointTooNew: it has a form that this version does not know.
    """
    if len(image) < HEADER.size or image[: len(MAGIC)] != MAGIC:
        raise CheckpointDamaged(f"these {available} bytes are no checkpoint: they do not begin like one")
    _, version, _, *fields = HEADER.unpack_from(image)
    if version > VERSION:
        raise CheckpointTooNew(f"the checkpoint has form {version}; this Robbie-MP reads up to {VERSION}")
    header = Header(*fields)
    if version < 1 or not HEADER.size <= header.size <= available:
        raise CheckpointDamaged(f"a checkpoint of {header.size} bytes, form {version}, in {available} bytes")
    if aligned(HEADER.size + header.structure_size) > header.size:
        raise CheckpointDamaged(f"a structure of {header.structure_size} bytes in {header.size} bytes")
    return header


def check_crc(image: memoryview, header: Header) -> None:
    """Check that an image holds what was written.

    Raises:
        CheckpointDamaged: it does not.
    """
    written = int(HEADER.unpack_from(image)[2])
    found = zlib.crc32(image[CRC_BEGIN : header.size])
    if found != written:
        raise CheckpointDamaged(f"the checkpoint's CRC is {found:08x}, {written:08x} was written")
