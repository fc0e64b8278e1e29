"""PNG images of every depth and colour type, interlaced or not, band by band (W3C PNG, third edition).

Pillow can only decode a whole image, and cuts colours of 16 bits to 8. Here it only undoes the filters of
section 9, which is slow in Python: they work on the bytes of a pixel one by one, so the first bytes of all
pixels of a band are an image of 8-bit greys, and so are the second ones.
"""

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from itertools import chain
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robbie_robots.workers.maps.image_band import (
    BAND_BYTES,
    Band,
    MapImage,
    MapImageError,
    check_size,
    sum_of,
)

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GREY, RGB, PALETTE, GREY_ALPHA, RGB_ALPHA = 0, 2, 3, 4, 6
CHANNELS = {GREY: 1, RGB: 3, PALETTE: 1, GREY_ALPHA: 2, RGB_ALPHA: 4}
NAMES = {
    GREY: "grey",
    RGB: "RGB",
    PALETTE: "palette",
    GREY_ALPHA: "grey and alpha",
    RGB_ALPHA: "RGB and alpha",
}
DEPTHS = {GREY: (1, 2, 4, 8, 16), PALETTE: (1, 2, 4, 8)}
ADAM7 = (
    (slice(0, None, 8), slice(0, None, 8)),
    (slice(0, None, 8), slice(4, None, 8)),
    (slice(4, None, 8), slice(0, None, 4)),
    (slice(0, None, 4), slice(2, None, 4)),
    (slice(2, None, 4), slice(0, None, 2)),
    (slice(0, None, 2), slice(1, None, 2)),
    (slice(1, None, 2), slice(0, None, 1)),
)
"""Rows and columns of each pass of an interlaced image (section 8)."""
MAX_FILTER = 4
PIECE = 65_536


class _Header(NamedTuple):
    width: int
    height: int
    depth: int
    colour: int
    compression: int
    filtering: int
    interlacing: int


class _Format(NamedTuple):
    """What the pixels of an image mean."""

    header: _Header
    palette: NDArray[np.uint8]  # (n, 3)
    transparency: bytes

    @property
    def channels(self) -> int:
        return CHANNELS[self.header.colour]

    def row_bytes(self, width: int) -> int:
        return -(-width * self.channels * self.header.depth // 8)


class _Pass(NamedTuple):
    """A part of the image that is filtered on its own: all of it, unless it is interlaced."""

    rows: range
    columns: range


def png_image(file: BinaryIO) -> MapImage:
    """Return the image of a file, which is at its beginning.

    Raises:
        MapImageError: It is damaged. The bands raise it, too.
    """
    file.read(len(SIGNATURE))
    chunks = _chunks(file)
    kept = {b"PLTE": b"", b"tRNS": b"", b"IHDR": b"", b"IDAT": b""}
    for kind, piece in chunks:
        if kind in kept:
            kept[kind] = piece
        if kind == b"IDAT":
            break
    form = _format(kept)
    header = form.header
    white = 255 * 3 if header.colour == PALETTE else (2**header.depth - 1) * (3 if form.channels > 2 else 1)
    kind_text = f"PNG, {NAMES[header.colour]}, {header.depth} bits"
    return MapImage(kind_text, header.width, header.height, white, _bands(form, kept[b"IDAT"], chunks))


def _chunks(file: BinaryIO) -> Iterator[tuple[bytes, bytes]]:
    """Yield the kind of each chunk and its data, long ones in pieces."""
    kind = b""
    while kind != b"IEND":
        length, kind = struct.unpack(">I4s", _exactly(file, 8))
        check = zlib.crc32(kind)
        while length:
            piece = _exactly(file, min(length, PIECE))
            check, length = zlib.crc32(piece, check), length - len(piece)
            yield kind, piece
        if _exactly(file, 4) != check.to_bytes(4, "big"):
            raise MapImageError(f"its chunk {kind!r} is damaged: the checksum is another")


def _exactly(file: BinaryIO, length: int) -> bytes:
    data = file.read(length)
    if len(data) < length:
        raise MapImageError("it ends too early")
    return data


def _format(kept: dict[bytes, bytes]) -> _Format:
    if len(kept[b"IHDR"]) != 13:
        raise MapImageError("it has no header")
    header = _Header(*struct.unpack(">IIBBBBB", kept[b"IHDR"]))
    check_size(header.width, header.height)
    is_known = header.colour in CHANNELS and header.depth in DEPTHS.get(header.colour, (8, 16))
    if not is_known or header.compression or header.filtering or header.interlacing > 1:
        raise MapImageError("its header is damaged: it has values that PNG does not define")
    colours, alpha = len(kept[b"PLTE"]), len(kept[b"tRNS"])
    sizes = {GREY: (0, 2), RGB: (0, 6), PALETTE: range(colours // 3 + 1)}.get(header.colour, (alpha,))
    if colours % 3 or colours > 768 or (header.colour == PALETTE and not colours) or alpha not in sizes:
        raise MapImageError("its palette or transparency is damaged")
    palette = np.frombuffer(kept[b"PLTE"], np.uint8).reshape(-1, 3)
    return _Format(header, palette, kept[b"tRNS"])


def _bands(form: _Format, first: bytes, chunks: Iterator[tuple[bytes, bytes]]) -> Iterator[Band]:
    passes = list(_passes(form.header))
    size = sum(len(one.rows) * (1 + form.row_bytes(len(one.columns))) for one in passes)
    read = _reader(_inflated(first, chunks, size))
    for one in passes:
        width, top = len(one.columns), 0
        for lines in _lines(form, one, read):
            samples = _samples(lines, form.header.depth)[:, : width * form.channels]
            levels, opaque = _levels(form, samples.reshape(len(lines), width, form.channels))
            yield Band(_slice(one.rows[top : top + len(lines)]), _slice(one.columns), levels, opaque)
            top += len(lines)
    for _ in chunks:  # the checksums of the last chunks
        pass


def _slice(places: range) -> slice:
    return slice(places.start, places.stop, places.step)


def _passes(header: _Header) -> Iterator[_Pass]:
    """Yield the passes that have pixels."""
    for rows, columns in ADAM7 if header.interlacing else ((slice(None), slice(None)),):
        one = _Pass(range(header.height)[rows], range(header.width)[columns])
        if one.rows and one.columns:
            yield one


def _inflated(first: bytes, chunks: Iterator[tuple[bytes, bytes]], size: int) -> Iterator[bytes]:
    """Yield the image's bytes, `size` in all; what may follow them is not inflated."""
    inflator = zlib.decompressobj()
    for piece in chain([first], (piece for kind, piece in chunks if kind == b"IDAT")):
        for data in _inflated_piece(inflator, piece):
            yield data[:size]
            size -= len(data)
            if size <= 0:
                return


def _inflated_piece(inflator: "zlib._Decompress", piece: bytes) -> Iterator[bytes]:
    is_more = True
    while is_more and not inflator.eof:
        try:
            data = inflator.decompress(piece, BAND_BYTES)
        except zlib.error as error:
            raise MapImageError(f"it is damaged: {error}") from error
        piece, is_more = inflator.unconsumed_tail, len(data) == BAND_BYTES
        if data:
            yield data


def _reader(pieces: Iterator[bytes]) -> Callable[[int], bytes]:
    """Return a function that reads a number of bytes."""
    waiting = bytearray()

    def read(length: int) -> bytes:
        while len(waiting) < length:
            piece = next(pieces, b"")
            if not piece:
                raise MapImageError("it ends too early")
            waiting.extend(piece)
        data = bytes(waiting[:length])
        del waiting[:length]
        return data

    return read


def _lines(form: _Format, one: _Pass, read: Callable[[int], bytes]) -> Iterator[NDArray[np.uint8]]:
    """Yield bands of the pass's rows `(h, bytes)` without their filters (section 9)."""
    row_bytes, pixel_bytes = form.row_bytes(len(one.columns)), max(1, form.channels * form.header.depth // 8)
    at_once = max(1, BAND_BYTES // row_bytes)
    above = np.zeros(row_bytes, np.uint8)
    for top in range(0, len(one.rows), at_once):
        count = min(at_once, len(one.rows) - top)
        filtered = np.frombuffer(read(count * (1 + row_bytes)), np.uint8).reshape(count, -1)
        lines = _unfiltered(filtered[:, :1], filtered[:, 1:], above, pixel_bytes)
        above = lines[-1]
        yield lines


def _unfiltered(
    filters: NDArray[np.uint8], filtered: NDArray[np.uint8], above: NDArray[np.uint8], pixel_bytes: int
) -> NDArray[np.uint8]:
    if filters.max() > MAX_FILTER:
        raise MapImageError(f"it is damaged: PNG has no filter {filters.max()}")
    if not filters.any():
        return filtered
    lines = np.empty_like(filtered)
    for byte in range(pixel_bytes):
        part = slice(byte, None, pixel_bytes)
        before = np.concatenate([[0], above[part]], dtype=np.uint8, casting="unsafe")
        lines[:, part] = _as_greys(np.vstack([before, np.hstack([filters, filtered[:, part]])]))[1:]
    return lines


def _as_greys(filtered: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the bytes of an image of 8-bit greys `(h, w)` whose rows begin with their filters."""
    height, width = filtered.shape[0], filtered.shape[1] - 1
    header = struct.pack(">IIBBBBB", width, height, 8, GREY, 0, 0, 0)
    data = zlib.compress(filtered.tobytes(), 0)
    file = io.BytesIO(SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b""))
    with Image.open(file, formats=["PNG"]) as image:
        return np.asarray(image)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _samples(lines: NDArray[np.uint8], depth: int) -> NDArray[np.unsignedinteger]:
    """Return the samples `(h, n)` that rows of bytes hold, with those that fill the last byte."""
    if depth == 8:
        return lines
    if depth == 16:
        return np.ascontiguousarray(lines).view(">u2")
    bits = np.unpackbits(lines, axis=1)
    samples = np.zeros_like(bits[:, ::depth])
    for bit in range(depth):
        samples |= bits[:, bit::depth] << np.uint8(depth - 1 - bit)
    return samples


def _levels(
    form: _Format, samples: NDArray[np.unsignedinteger]
) -> tuple[NDArray[np.unsignedinteger], NDArray[np.bool_] | None]:
    """Return the levels of pixels `(h, w)`, and which of them are opaque."""
    header, transparency = form.header, form.transparency
    if header.colour == PALETTE:
        return _from_palette(form, samples[..., 0])
    colours = samples[..., : 3 if form.channels > 2 else 1]
    levels = colours[..., 0] if form.channels <= 2 else sum_of(colours)
    if header.colour in (GREY_ALPHA, RGB_ALPHA):
        return levels, samples[..., -1] == 2**header.depth - 1
    if transparency:
        return levels, (colours != np.frombuffer(transparency, ">u2")).any(axis=2)
    return levels, None


def _from_palette(
    form: _Format, places: NDArray[np.unsignedinteger]
) -> tuple[NDArray[np.unsignedinteger], NDArray[np.bool_] | None]:
    if places.max() >= len(form.palette):
        raise MapImageError(f"it is damaged: its palette has no colour {places.max()}")
    levels = form.palette.sum(axis=1, dtype=np.uint32)[places]
    alpha = np.frombuffer(form.transparency.ljust(len(form.palette), b"\xff"), np.uint8)
    return levels, alpha[places] == 255 if form.transparency else None
