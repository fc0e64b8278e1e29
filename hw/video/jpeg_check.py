"""Checks JPEG images without decoding them.

Source: ITU-T T.81 (JPEG), Annex B.
"""

import re
from dataclasses import dataclass

from robbie_robots.hw.framing import DamagedFrame

START, END = b"\xff\xd8", 0xD9
SCAN, RESTART_0 = 0xDA, 0xD0
FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
HUFFMAN_SEQUENTIAL = (0xC0, 0xC1)
# What ends or restarts a scan: a marker that is neither a byte FF of the data nor filling.
_MARKER = re.compile(rb"\xff+([^\x00\xff])")


@dataclass(frozen=True)
class JpegLayout:
    """The contents of a JPEG image's frame header.

    Attributes:
        width: columns.
        height: rows.
        least_scan_bytes: least length of the coded data; 0 if unknown.
    """

    width: int
    height: int
    least_scan_bytes: int


def whole_jpeg(image: bytes, width: int, height: int) -> bytes:
    """Return a JPEG image without what may follow its end.

    Args:
        image: what a camera sent for one image.
        width: the columns that it must have.
        height: the rows that it must have.

    Raises:
        DamagedFrame: it does not begin or end as an image, or has parts missing, or another size.
    """
    layout, position = None, len(START)
    scan_bytes = 0
    if not image.startswith(START):
        raise DamagedFrame("no JPEG image: it does not begin with SOI")
    while True:
        mark, position = _mark(image, position)
        if mark == END:
            break
        begin, position = position, position + _length(image, position)
        if mark in FRAMES:
            layout = _layout(mark, image[begin + 2 : position])
        elif mark == SCAN:
            data_end = _scan_end(image, position)
            scan_bytes += data_end - position
            position = data_end
    _check(layout, scan_bytes, (width, height))
    return image[:position]


def _check(layout: JpegLayout | None, scan_bytes: int, wanted: tuple[int, int]) -> None:
    if layout is None or not scan_bytes:
        raise DamagedFrame("a JPEG image without a frame or a scan")
    if (layout.width, layout.height) != wanted:
        raise DamagedFrame(f"a JPEG image of {layout.width} x {layout.height}, not {wanted[0]} x {wanted[1]}")
    if scan_bytes < layout.least_scan_bytes:
        raise DamagedFrame(f"{scan_bytes} bytes code no image of {layout.width} x {layout.height}")


def _mark(image: bytes, position: int) -> tuple[int, int]:
    match = _MARKER.match(image, position)
    if match is None:
        raise DamagedFrame(f"no marker at byte {position} of {len(image)}")
    return match[1][0], match.end()


def _length(image: bytes, position: int) -> int:
    length = int.from_bytes(image[position : position + 2], "big")
    if length < 2 or position + length > len(image):
        raise DamagedFrame(f"a segment of {length} bytes at byte {position} of {len(image)}")
    return length


def _layout(mark: int, contents: bytes) -> JpegLayout:
    if len(contents) < 6 or len(contents) != 6 + 3 * contents[5] or not contents[5]:
        raise DamagedFrame(f"a frame header of {len(contents)} bytes")
    height, width = int.from_bytes(contents[1:3], "big"), int.from_bytes(contents[3:5], "big")
    factors = [(byte >> 4, byte & 15) for byte in contents[7::3]]
    if not (width and height and all(across and down for across, down in factors)):
        raise DamagedFrame(f"a frame of {width} x {height} with sampling factors {factors}")
    blocks = _blocks(width, height, factors) if mark in HUFFMAN_SEQUENTIAL else 0
    # Each block has a code for its brightness and one for its end, of at least a bit each.
    return JpegLayout(width, height, blocks * 2 // 8)


def _blocks(width: int, height: int, factors: list[tuple[int, int]]) -> int:
    most_across, most_down = max(across for across, _ in factors), max(down for _, down in factors)
    return sum(
        -(-width * across // (8 * most_across)) * -(-height * down // (8 * most_down))
        for across, down in factors
    )


def _scan_end(image: bytes, position: int) -> int:
    """Return where the next marker is that ends a scan; restarts within it must be in order."""
    expected = 0
    for match in _MARKER.finditer(image, position):
        restart = match[1][0] - RESTART_0
        if not 0 <= restart < 8:
            return match.start()
        if restart != expected:
            raise DamagedFrame(f"restart {restart} where restart {expected} should be: a part is missing")
        expected = (expected + 1) % 8
    raise DamagedFrame("a JPEG image without an end")
