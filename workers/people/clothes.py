"""How persons are dressed: histograms of the colours of upper body and legs in a camera's picture.

Swain and Ballard, "Color indexing" (IJCV 1991), with chromaticity beside brightness, and compared by the
coefficient of Bhattacharyya.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

CHROMA_BINS, LIGHT_BINS = 10, 4
CHROMA_RANGE = (0.1, 0.7)
PART_BINS = CHROMA_BINS * CHROMA_BINS * LIGHT_BINS
PARTS_M = ((0.98, 1.38), (0.3, 0.75))
"""Heights of upper body and legs above the floor."""
HALF_WIDTH_M = 0.12
"""Only the middle of a person is looked at, because its place is not exactly known."""
NEAREST_M, FARTHEST_M = 0.4, 6.0
FEWEST_COLUMNS, FEWEST_ROWS = 4, 6
NO_PART = np.full(PART_BINS, np.nan)


class ClothesView(NamedTuple):
    """A camera's picture and where it was taken.

    Attributes:
        pixels: (height, width, 3) uint8, red, green, blue.
        focal_px: focal length.
        centre_px: column and row of the principal point.
        rotation: (3, 3), from the map's frame to the optical frame (z ahead, x right, y down).
        eye_m: (3,), m, map frame.
    """

    pixels: NDArray[np.uint8]
    focal_px: float
    centre_px: tuple[float, float]
    rotation: Array
    eye_m: Array

    def place(self, point_m: ArrayLike) -> Array:
        """Return where a point (3,), m, map frame, is in the picture: column, row, and its depth in m."""
        x, y, depth = self.rotation @ (np.asarray(point_m, float) - self.eye_m)
        scale = self.focal_px / max(float(depth), 1e-6)
        return np.array([self.centre_px[0] + scale * x, self.centre_px[1] + scale * y, depth])


def clothes_in(view: ClothesView, persons_m: Array) -> list[Array | None]:
    """Return how each person is dressed; None for those who are not seen well.

    Args:
        view: the picture.
        persons_m: (N, 2), m, map frame. Those who stand behind another one are not seen well.

    Returns:
        For each person `(2 * PART_BINS,)`: the histograms of both parts; NaN for a part out of the picture.
    """
    columns = [_columns(view, xy) for xy in persons_m]
    found: list[Array | None] = []
    for index, (xy, own) in enumerate(zip(persons_m, columns, strict=True)):
        hidden = own is None or any(
            other is not None and other[2] < own[2] and other[0] < own[1] and own[0] < other[1]
            for place, other in enumerate(columns)
            if place != index
        )
        found.append(None if own is None or hidden else _histograms(view, xy, own))
    return found


def similarity(first: Array, second: Array) -> float | None:
    """Return how alike clothes are, 0 to 1; None if no upper body was seen on one of them."""
    roots = np.sqrt(first * second).reshape(2, -1).sum(axis=1)
    if np.isnan(roots[0]):
        return None
    return float(np.nanmean(roots))


def blended(old: Array, new: Array, share: float) -> Array:
    """Return clothes that take a share of newer ones; a part that was seen once stays known."""
    mixed: Array = np.where(np.isnan(old), new, np.where(np.isnan(new), old, (1 - share) * old + share * new))
    return mixed


def _columns(view: ClothesView, xy: Array) -> tuple[float, float, float] | None:
    """Return the columns from and to which a person's middle is seen, and its depth."""
    column, _row, depth = view.place([*xy, 1.0])
    if not NEAREST_M <= depth <= FARTHEST_M:
        return None
    half = view.focal_px * HALF_WIDTH_M / depth
    return column - half, column + half, float(depth)


def _histograms(view: ClothesView, xy: Array, columns: tuple[float, float, float]) -> Array | None:
    height, width, _ = view.pixels.shape
    left, right = round(columns[0]), round(columns[1])
    if left < 0 or right > width or right - left < FEWEST_COLUMNS:
        return None
    parts = []
    for low_m, high_m in PARTS_M:
        top, bottom = view.place([*xy, high_m])[1], view.place([*xy, low_m])[1]
        first, last = max(0, round(top)), min(height, round(bottom))
        is_seen = last - first >= max(FEWEST_ROWS, 0.5 * (bottom - top))
        parts.append(_histogram(view.pixels[first:last, left:right]) if is_seen else NO_PART)
    return None if np.isnan(parts[0][0]) else np.concatenate(parts)


def _histogram(pixels: NDArray[np.uint8]) -> Array:
    """Return a part's histogram `(PART_BINS,)`, smoothed, of sum 1."""
    values = pixels.reshape(-1, 3).astype(np.float64) + 1.0
    total = values.sum(axis=1)
    low, high = CHROMA_RANGE
    chroma = (values[:, :2] / total[:, None] - low) / (high - low) * CHROMA_BINS
    red, green = np.clip(chroma.astype(np.intp), 0, CHROMA_BINS - 1).T
    light = np.clip((total / 768 * LIGHT_BINS).astype(np.intp), 0, LIGHT_BINS - 1)
    place = (red * CHROMA_BINS + green) * LIGHT_BINS + light
    counts = np.bincount(place, minlength=PART_BINS).reshape(CHROMA_BINS, CHROMA_BINS, LIGHT_BINS)
    smooth = counts.astype(np.float64)
    for axis in range(3):  # a colour near the edge of a bin counts for the next one, too
        padded = np.pad(smooth, [(1, 1) if each == axis else (0, 0) for each in range(3)], mode="edge")
        before, after = np.delete(padded, [-1, -2], axis), np.delete(padded, [0, 1], axis)
        smooth = 0.5 * smooth + 0.25 * before + 0.25 * after
    flat: Array = smooth.ravel() / smooth.sum()
    return flat
