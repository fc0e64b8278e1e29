"""Finds boards in a camera's image, and reads the digit of each, or the row of digits of a sheet."""

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.numbers.digit_reader import LineReader, Reading
from robbie_robots.workers.numbers.quadrangles import Quadrangle, QuadrangleFinder

Image = NDArray[np.uint8]

BOARD_PX = 128
"""A board is looked at in a square of this edge."""
EDGE_SHARE = 0.06
"""This share of a board at each side is its frame, and not looked at."""
SHEET_WIDTH = 1.6
"""A board wider than this multiple of its height is a sheet."""
MIN_CONTRAST = 35
MIN_GLYPH_SHARE = 0.25
MIN_INK_PX = 40
INK_PX, INK_DARKNESS = 31, 0.62
"""Strokes are thinner than the first, and darker than the second as a share of the paper beside them."""
MAX_GLYPH_WIDTH = 0.95
"""Digits are narrower than high. The network takes wide arrows and stars for digits."""
MIN_CONFIDENCE = 0.5
BESIDE, ABOVE = 0.06, 0.15
"""Margins around a glyph, as shares of its height, with which the network was measured to read best."""


@dataclass(frozen=True)
class BoardSighting:
    """A board in one image.

    Attributes:
        quadrangle: where it is.
        text: a digit; for a sheet, a row of digits; '' for a board that shows something else.
        confidence: 0 … 1, of the text.
        height_px: height of what is written on it, in the image.
    """

    quadrangle: Quadrangle
    text: str
    confidence: float
    height_px: float

    @property
    def is_sheet(self) -> bool:
        """Return whether the board is wide."""
        return _is_wide(self.quadrangle)


class BoardReader:
    """Reads all boards in images.

    Raises:
        QuadranglesMissing: OpenCV is not installed.
        ReaderMissing: what reads digits is not installed.
    """

    def __init__(self) -> None:
        self._finder = QuadrangleFinder()
        self._reader = LineReader()
        self._cv2: Any = import_module("cv2")

    def read(self, pixels: Image) -> list[BoardSighting]:
        """Return the boards with something dark on a light ground, the largest first.

        Of several quadrangles within one another, such as a board's frame, the one read most surely counts.

        Args:
            pixels: (height, width, 3) uint8, red, green, blue.
        """
        grey: Image = self._cv2.cvtColor(pixels, self._cv2.COLOR_RGB2GRAY)
        sightings: list[BoardSighting] = []
        for quadrangle in self._finder.find(grey):
            seen = self._look(grey, quadrangle)
            if seen is not None:
                _add(sightings, seen)
        return sightings

    def _look(self, grey: Image, quadrangle: Quadrangle) -> BoardSighting | None:
        """Read one quadrangle; return None if nothing is written on it."""
        is_wide = _is_wide(quadrangle)
        width_px = round(BOARD_PX * quadrangle.width_px / quadrangle.height_px) if is_wide else BOARD_PX
        board = self._finder.view(grey, quadrangle, width_px, BOARD_PX)
        edge = round(EDGE_SHARE * BOARD_PX)
        board = board[edge:-edge, edge:-edge]
        box = self._ink(board)
        if box is None:
            return None
        top, bottom, left, right = box
        share = (bottom - top) / BOARD_PX
        height_px = share * quadrangle.height_px
        if is_wide:
            reading = self._reader.read(_cut(board, box))
        elif right - left > MAX_GLYPH_WIDTH * (bottom - top):
            reading = Reading("", 0.0)
        else:
            reading = self._read_twice(_cut(board, box))
        text = reading.text if reading.is_number and reading.confidence >= MIN_CONFIDENCE else ""
        return BoardSighting(quadrangle, text, reading.confidence if text else 0.0, height_px)

    def _read_twice(self, glyph: Image) -> Reading:
        """Read a digit beside itself: the network was made for lines, and often misses a single character."""
        reading = self._reader.read(np.concatenate([glyph, glyph], axis=1))
        is_twice = len(reading.text) == 2 and reading.text[0] == reading.text[1]
        return Reading(reading.text[:1], reading.confidence) if is_twice else Reading("", 0.0)

    def _ink(self, board: Image) -> tuple[int, int, int, int] | None:
        """Return top, bottom, left and right of what is written on a board; None if nothing is."""
        low, high = np.percentile(board, [2, 90])
        if high - low < MIN_CONTRAST:
            return None
        # A closing fills the ink, but keeps the border of a shadow on the board where it is.
        # Beyond the board's edge it goes on as at the edge: there, a narrow corner of a shadow is no ink.
        wide = np.pad(board, INK_PX, mode="edge")
        kernel = np.ones((INK_PX, INK_PX), np.uint8)
        ground = self._cv2.morphologyEx(wide, self._cv2.MORPH_CLOSE, kernel)
        ground = ground[INK_PX:-INK_PX, INK_PX:-INK_PX]
        ink = (board < INK_DARKNESS * ground.astype(np.float32)).astype(np.uint8)
        count, _, figures, _ = self._cv2.connectedComponentsWithStats(ink)
        rows, columns = board.shape
        boxes = []
        for left, top, width, height, pixels in figures[1:count].tolist():
            touches = left == 0 or top == 0 or left + width == columns or top + height == rows
            if not touches and pixels >= MIN_INK_PX:
                boxes.append((top, top + height, left, left + width))
        if not boxes:
            return None
        tops, bottoms, lefts, rights = zip(*boxes, strict=True)
        box = min(tops), max(bottoms), min(lefts), max(rights)
        return box if box[1] - box[0] >= MIN_GLYPH_SHARE * BOARD_PX else None


def _add(sightings: list[BoardSighting], seen: BoardSighting) -> None:
    """Add a sighting, or replace one of the same board if it is better: what was read most surely."""
    for place, other in enumerate(sightings):
        if _is_within(seen.quadrangle, other.quadrangle) or _is_within(other.quadrangle, seen.quadrangle):
            if seen.confidence > other.confidence:
                sightings[place] = seen
            return
    sightings.append(seen)


def _is_within(one: Quadrangle, other: Quadrangle) -> bool:
    low, high = other.corners_px.min(axis=0), other.corners_px.max(axis=0)
    middle = one.corners_px.mean(axis=0)
    return bool((middle > low).all() and (middle < high).all())


def _is_wide(quadrangle: Quadrangle) -> bool:
    return quadrangle.width_px > SHEET_WIDTH * quadrangle.height_px


def _cut(board: Image, box: tuple[int, int, int, int]) -> Image:
    """Cut out what is written, with a margin; beyond the board's edge the margin repeats the edge."""
    top, bottom, left, right = box
    beside, above = round(BESIDE * (bottom - top)), round(ABOVE * (bottom - top))
    margin = max(beside, above)
    wide = np.pad(board, margin, mode="edge")
    return wide[
        margin + top - above : margin + bottom + above, margin + left - beside : margin + right + beside
    ]
