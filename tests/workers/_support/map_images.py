"""Writes images of maps in every PNG and PNM type, and says what each pixel shows."""

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction

from tests.workers._support.map_server import Pixel

Samples = list[list[tuple[int, ...]]]
"""Rows of pixels, uppermost first, each with its channels."""
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


@dataclass
class Png:
    """A PNG image.

    Attributes:
        filter_of: which filter a row of a pass has.
    """

    colour: int
    depth: int
    samples: Samples
    palette: list[tuple[int, int, int]] = field(default_factory=list)
    transparency: tuple[int, ...] = ()
    is_interlaced: bool = False
    filter_of: Callable[[int], int] = lambda row: row % 5

    def pixels(self) -> list[list[Pixel]]:
        """Return what the pixels show."""
        return [[self._pixel(one) for one in row] for row in self.samples]

    def _pixel(self, one: tuple[int, ...]) -> Pixel:
        white = 2**self.depth - 1
        if self.colour == 3:
            (place,) = one
            alpha = self.transparency[place] if place < len(self.transparency) else 255
            return Pixel(Fraction(sum(self.palette[place]), 3 * 255), alpha == 255)
        if self.colour in (4, 6):
            return Pixel(Fraction(sum(one[:-1]), (len(one) - 1) * white), one[-1] == white)
        return Pixel(Fraction(sum(one), len(one) * white), one != self.transparency)

    def to_bytes(self) -> bytes:
        """Return the file."""
        height, width = len(self.samples), len(self.samples[0])
        header = struct.pack(">IIBBBBB", width, height, self.depth, self.colour, 0, 0, self.is_interlaced)
        chunks = [_chunk(b"IHDR", header), _chunk(b"tEXt", b"Comment\0a map")]
        if self.colour == 3:
            chunks.append(_chunk(b"PLTE", b"".join(map(bytes, self.palette))))
        if self.transparency:
            kind = "B" if self.colour == 3 else "H"
            chunks.append(
                _chunk(b"tRNS", struct.pack(f">{len(self.transparency)}{kind}", *self.transparency))
            )
        data = zlib.compress(b"".join(self._filtered(part) for part in self._passes()))
        half = len(data) // 2
        chunks += [_chunk(b"IDAT", data[:half]), _chunk(b"IDAT", data[half:]), _chunk(b"IEND", b"")]
        return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)

    def _passes(self) -> list[Samples]:
        if not self.is_interlaced:
            return [self.samples]
        parts = [[row[x::dx] for row in self.samples[y::dy]] for x, y, dx, dy in ADAM7]
        return [part for part in parts if part and part[0]]

    def _filtered(self, part: Samples) -> bytes:
        step = max(1, CHANNELS[self.colour] * self.depth // 8)
        above, filtered = b"", b""
        for number, row in enumerate(part):
            line = self._packed([sample for one in row for sample in one])
            kind = self.filter_of(number)
            filtered += bytes([kind]) + _filtered(kind, line, above or bytes(len(line)), step)
            above = line
        return filtered

    def _packed(self, samples: list[int]) -> bytes:
        bits = "".join(f"{sample:0{self.depth}b}" for sample in samples)
        bits += "0" * (-len(bits) % 8)
        return int(bits, 2).to_bytes(len(bits) // 8, "big")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _filtered(kind: int, line: bytes, above: bytes, step: int) -> bytes:
    """Filter a row as section 9.2 of the PNG specification says."""
    filtered = []
    for index, value in enumerate(line):
        left = line[index - step] if index >= step else 0
        corner = above[index - step] if index >= step else 0
        up = above[index]
        guess = (0, left, up, (left + up) // 2, _paeth(left, up, corner))[kind]
        filtered.append((value - guess) % 256)
    return bytes(filtered)


def _paeth(left: int, up: int, corner: int) -> int:
    guess = left + up - corner
    return min((left, up, corner), key=lambda one: abs(guess - one))


@dataclass
class Pnm:
    """An image of the Netpbm formats P1 to P6."""

    number: int
    largest: int
    samples: Samples
    comment: str = ""

    def pixels(self) -> list[list[Pixel]]:
        """Return what the pixels show."""
        return [[Pixel(self._shade(one)) for one in row] for row in self.samples]

    def _shade(self, one: tuple[int, ...]) -> Fraction:
        shade = Fraction(sum(one), len(one) * self.largest)
        return 1 - shade if self.number in (1, 4) else shade

    def to_bytes(self) -> bytes:
        """Return the file."""
        height, width = len(self.samples), len(self.samples[0])
        remark = f"# {self.comment}\n" if self.comment else ""
        header = f"P{self.number}\n{remark}{width} {remark}{height}"
        header += "\n" if self.number in (1, 4) else f"\n{remark}{self.largest}\n"
        rows = [[sample for one in row for sample in one] for row in self.samples]
        if self.number < 4:
            lines = (("" if self.number == 1 else " ").join(map(str, row)) for row in rows)
            return (header + f"\n{remark}".join(lines)).encode() + b"\n"
        return header.encode() + b"".join(map(self._raster, rows))

    def _raster(self, row: list[int]) -> bytes:
        if self.number == 4:
            bits = "".join(map(str, row)) + "0" * (-len(row) % 8)
            return int(bits, 2).to_bytes(len(bits) // 8, "big")
        return struct.pack(f">{len(row)}{'B' if self.largest < 256 else 'H'}", *row)
