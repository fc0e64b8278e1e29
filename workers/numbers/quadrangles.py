"""Finds boards in images, which are quadrangles there, and shows each as seen from straight ahead."""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Corners = NDArray[np.float32]

BLOCK_PX, DARKER = 41, 7
"""A board without a frame is brighter by this than the mean of its surroundings."""
FRAMES_PX = (9, 25)
FRAME_DARKNESS = 0.72
"""A frame is thinner than the first and darker than this share of what is beside it, also in a shadow."""
CORNER_SHARE = 0.035
"""A contour is a quadrangle if its corners deviate by at most this share of its length."""
MIN_FILL = 0.9
SAME_SHARE = 0.08
"""Quadrangles are the same if their corners are nearer than this share of their height."""
MAX_NUMBER = 32


class QuadranglesMissing(ImportError):
    """OpenCV is not installed."""


@dataclass(frozen=True)
class Quadrangle:
    """A quadrangle in an image, such as a board.

    Attributes:
        corners_px: (4, 2), columns and rows, from the upper left one in the direction of a clock's hands.
    """

    corners_px: Corners

    @property
    def middle_px(self) -> tuple[float, float]:
        """Return column and row where the diagonals meet: the middle of the board, not that of its image."""
        first, second, third, fourth = self.corners_px.astype(float)
        along, across, between = third - first, fourth - second, second - first
        scale = along[0] * across[1] - along[1] * across[0]
        if abs(scale) < 1e-9:
            x, y = self.corners_px.mean(axis=0).tolist()
        else:
            share = (between[0] * across[1] - between[1] * across[0]) / scale
            x, y = (first + share * along).tolist()
        return x, y

    @property
    def edges_px(self) -> NDArray[np.float64]:
        """Return the lengths of the upper, right, lower and left edge: (4,)."""
        steps = np.roll(self.corners_px, -1, axis=0).astype(float) - self.corners_px
        lengths: NDArray[np.float64] = np.hypot(steps[:, 0], steps[:, 1])
        return lengths

    @property
    def height_px(self) -> float:
        """Return the mean length of the upright edges."""
        return float(self.edges_px[[1, 3]].mean())

    @property
    def width_px(self) -> float:
        """Return the mean length of the other edges; a slanted board is as high as before, but narrower."""
        return float(self.edges_px[[0, 2]].mean())


class QuadrangleFinder:
    """Finds upright quadrangles.

    Args:
        min_height_px: smaller ones are ignored.
        max_width: wider ones, as a multiple of their height, are ignored.

    Raises:
        QuadranglesMissing: OpenCV is not installed.
    """

    def __init__(self, min_height_px: float = 16.0, max_width: float = 8.0) -> None:
        try:
            cv2: Any = import_module("cv2")
        except ImportError as error:
            raise QuadranglesMissing(
                "signs are found with OpenCV: install opencv-python-headless (extra 'digits')"
            ) from error
        cv2.setNumThreads(1)  # leave the robot's other processor cores free
        self._cv2 = cv2
        self._min_height_px = min_height_px
        self._max_width = max_width

    def find(self, grey: Image) -> list[Quadrangle]:
        """Return the quadrangles in an image, the largest first; also those within others.

        Args:
            grey: (height, width) uint8.
        """
        found: list[Quadrangle] = []
        for dark in self._dark_places(grey):
            contours, _ = self._cv2.findContours(dark, self._cv2.RETR_LIST, self._cv2.CHAIN_APPROX_SIMPLE)
            found += [one for one in map(self._quadrangle, contours) if one is not None]
        return _distinct(found)[:MAX_NUMBER]

    def view(self, image: Image, quadrangle: Quadrangle, width_px: int, height_px: int) -> Image:
        """Return the quadrangle as seen from straight ahead: (height_px, width_px) or (…, 3) uint8."""
        right, bottom = width_px - 1.0, height_px - 1.0
        straight = np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]], np.float32)
        transform = self._cv2.getPerspectiveTransform(quadrangle.corners_px, straight)
        seen: Image = self._cv2.warpPerspective(image, transform, (width_px, height_px))
        return seen

    def _dark_places(self, grey: Image) -> Iterator[Image]:
        """Return images that are not 0 where something is darker than what surrounds it."""
        cv2 = self._cv2
        mean, inverse = cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV
        yield cv2.adaptiveThreshold(grey, 255, mean, inverse, BLOCK_PX, DARKER)
        for frame_px in FRAMES_PX:
            # A closing fills what is dark and thin, but keeps the borders of shadows where they are.
            ground = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((frame_px, frame_px), np.uint8))
            yield (grey < FRAME_DARKNESS * ground.astype(np.float32)).astype(np.uint8)

    def _quadrangle(self, contour: NDArray[np.int32]) -> Quadrangle | None:
        """Return a contour as a quadrangle, if it is one of a suitable size and shape."""
        _, _, width, height = self._cv2.boundingRect(contour)
        if height < self._min_height_px or width < self._min_height_px / 3:
            return None
        length = self._cv2.arcLength(contour, True)
        corners = self._cv2.approxPolyDP(contour, CORNER_SHARE * length, True)
        if len(corners) != 4 or not self._cv2.isContourConvex(corners):
            return None
        area = self._cv2.contourArea(corners)
        if area <= 0 or not MIN_FILL < self._cv2.contourArea(contour) / area < 1 / MIN_FILL:
            return None
        quadrangle = Quadrangle(_from_upper_left(corners.reshape(4, 2).astype(np.float32)))
        slope = np.abs(np.diff(quadrangle.corners_px[[0, 3, 1, 2]], axis=0)[[0, 2], :])
        is_upright = bool((slope[:, 0] < 0.35 * slope[:, 1]).all())
        is_large = quadrangle.height_px >= self._min_height_px
        is_narrow = quadrangle.width_px <= self._max_width * quadrangle.height_px
        return quadrangle if is_upright and is_large and is_narrow else None


def _from_upper_left(corners: Corners) -> Corners:
    """Sort corners: the upper left one first, then in the direction of a clock's hands."""
    by_column = corners[np.argsort(corners[:, 0], kind="stable")]
    left = by_column[:2][np.argsort(by_column[:2, 1])]
    right = by_column[2:][np.argsort(by_column[2:, 1])]
    return np.stack([left[0], right[0], right[1], left[1]])


def _distinct(found: list[Quadrangle]) -> list[Quadrangle]:
    """Drop each quadrangle whose corners are almost those of a smaller one; the largest comes first."""
    kept: list[Quadrangle] = []
    for one in sorted(found, key=lambda each: each.height_px):
        near_px = SAME_SHARE * one.height_px
        if not any(np.abs(one.corners_px - other.corners_px).max() < near_px for other in kept):
            kept.append(one)
    return kept[::-1]
