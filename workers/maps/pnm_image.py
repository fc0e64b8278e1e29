"""Images of the Netpbm formats PBM, PGM and PPM, binary and plain (https://netpbm.sourceforge.net/doc/)."""

import re
from collections.abc import Iterator
from functools import partial
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.maps.image_band import (
    BAND_BYTES,
    Band,
    MapImage,
    MapImageError,
    check_size,
    sum_of,
)

KINDS = {b"P1": "plain PBM", b"P2": "plain PGM", b"P3": "plain PPM", b"P4": "PBM", b"P5": "PGM", b"P6": "PPM"}
MAX_HEADER = 65_536
MAX_DIGITS = 9
SPACES = (b" ", b"\n", b"\t", b"\r", b"\v", b"\f")
COMMENT = re.compile(rb"#[^\r\n]*")

Levels = NDArray[np.unsignedinteger]


def pnm_image(file: BinaryIO) -> MapImage:
    """Return the image of a file, which is at its beginning.

    Raises:
        MapImageError: It is damaged. The bands raise it, too.
    """
    magic = file.read(2)
    width, height = _number(file), _number(file)
    check_size(width, height)
    largest = 1 if magic in (b"P1", b"P4") else _number(file)
    if not 1 <= largest <= 65_535:
        raise MapImageError(f"its largest value must be 1 to 65535, not {largest}")
    channels = 3 if magic in (b"P3", b"P6") else 1
    rows = _binary_rows if magic >= b"P4" else _plain_rows
    bands = _bands(rows(file, magic, height, width * channels, largest), height, channels, largest)
    return MapImage(f"{KINDS[magic]}, values to {largest}", width, height, largest * channels, bands)


def _number(file: BinaryIO) -> int:
    """Return the next number of the header, and read the one white space after it."""
    digits = b""
    while file.tell() < MAX_HEADER:
        char = file.read(1)
        if char == b"#":
            file.readline(MAX_HEADER)
        elif char.isdigit() and len(digits) < MAX_DIGITS:
            digits += char
            continue
        elif not char.isspace():
            break
        if digits:
            return int(digits)
    raise MapImageError("its header is damaged: numbers for width, height and largest value are expected")


def _bands(parts: Iterator[Levels], height: int, channels: int, largest: int) -> Iterator[Band]:
    top = 0
    for values in parts:
        if values.max() > largest:  # a viewer may take it for white, which a robot would drive on
            raise MapImageError(f"it holds the value {values.max()}, but its largest value is {largest}")
        colours = values.reshape(len(values), -1, channels)
        levels = values if channels == 1 else sum_of(colours)
        yield Band(slice(top, top + len(values)), slice(None), levels)
        top += len(values)
    if top < height:
        raise MapImageError(f"it ends after {top} of {height} rows")


def _binary_rows(file: BinaryIO, magic: bytes, height: int, values: int, largest: int) -> Iterator[Levels]:
    """Yield bands of whole rows `(h, values)`."""
    kind = np.dtype("u1" if largest < 256 else ">u2")
    row_bytes = -(-values // 8) if magic == b"P4" else values * kind.itemsize
    at_once = max(1, BAND_BYTES // row_bytes)
    for top in range(0, height, at_once):
        data = file.read(min(at_once, height - top) * row_bytes)
        whole = len(data) // row_bytes
        if not whole:
            return
        rows = np.frombuffer(data[: whole * row_bytes], np.uint8).reshape(whole, -1)
        yield 1 - np.unpackbits(rows, axis=1, count=values) if magic == b"P4" else rows.view(kind)


def _plain_rows(file: BinaryIO, magic: bytes, height: int, values: int, _: int) -> Iterator[Levels]:
    """Yield bands of whole rows `(h, values)`."""
    parse = _bits if magic == b"P1" else _numbers
    waiting: list[Levels] = []
    for text in _plain_texts(file, magic == b"P1"):
        waiting.append(parse(text))
        rows = min(sum(map(len, waiting)) // values, height)
        if rows:
            numbers = np.concatenate(waiting)
            waiting, height = [numbers[rows * values :]], height - rows
            yield numbers[: rows * values].reshape(rows, values)
        if not height:
            return


def _plain_texts(file: BinaryIO, is_bits: bool) -> Iterator[bytes]:
    """Yield a plain image without its comments, in parts that end between numbers; bits need no space."""
    rest = b""
    for read in iter(partial(file.read, BAND_BYTES), b""):
        text = rest + read
        comment = text.find(b"#", max(text.rfind(b"\n"), text.rfind(b"\r")) + 1)
        end = len(text) if is_bits else 1 + max(map(text.rfind, SPACES))
        if comment >= 0:  # the part ends within a comment, which goes on in the next one
            end, rest = comment, b"#"
        elif len(rest := text[end:]) > MAX_DIGITS:
            raise MapImageError("it holds a text where a number is expected")
        yield COMMENT.sub(b" ", text[:end])
    yield COMMENT.sub(b" ", rest)


def _numbers(text: bytes) -> Levels:
    words = text.split()
    if words and (max(map(len, words)) > MAX_DIGITS or not b"".join(words).isdigit()):
        raise MapImageError("it holds a text where a number is expected")
    return np.array(words, f"S{MAX_DIGITS}").astype(np.uint32)


def _bits(text: bytes) -> Levels:
    bits = np.frombuffer(b"".join(text.split()), np.uint8)
    if ((bits != ord("0")) & (bits != ord("1"))).any():
        raise MapImageError("it holds something else than 0 and 1")
    return ord("1") - bits  # 1 is black
