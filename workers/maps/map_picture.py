"""A picture of a map to look at: free white, occupied black, unknown grey; paths, scale bar and legend."""

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

UNKNOWN = 170  # grey
SMALLEST_PX, LARGEST_PX = 900, 2400  # of the picture's longer side
BORDER_M = 0.5
FOOTER_PX = 40
INK = (40, 40, 40)
ESTIMATED = (200, 30, 30)
TRUE = (30, 100, 220)
BAR_LENGTHS_M = (0.5, 1, 2, 5, 10, 20, 50, 100, 200)
WIDEST_BAR = 0.2  # share of the picture's width


def map_picture(
    cells: NDArray[np.int8],
    corner_xy_m: ArrayLike,
    resolution_m: float,
    estimated_path: ArrayLike | None = None,
    true_path: ArrayLike | None = None,
) -> bytes:
    """Return a picture of a map, as PNG.

    Args:
        cells: Occupancy in percent `(H, W)`, row 0 at the smallest y, -1 for unknown.
        corner_xy_m: The corner of cell (0, 0), m, map frame.
        resolution_m: Edge of a cell.
        estimated_path: `(N, 2)`, m, map frame, drawn in red.
        true_path: `(N, 2)`, m, map frame, drawn in blue.
    """
    paths = [
        (np.asarray(xy_m, float).reshape(-1, 2), colour, name)
        for xy_m, colour, name in (
            (true_path, TRUE, "true path"),
            (estimated_path, ESTIMATED, "estimated path"),
        )
        if xy_m is not None
    ]
    view = _view(cells, np.asarray(corner_xy_m, float), resolution_m, [xy_m for xy_m, _, _ in paths])
    picture = Image.new("RGB", (view.width_px, view.height_px + FOOTER_PX), "white")
    picture.paste(_ground(cells, np.asarray(corner_xy_m, float), resolution_m, view))
    draw = ImageDraw.Draw(picture)
    for xy_m, colour, _ in paths:
        draw.line([tuple(point) for point in view.pixels(xy_m)], fill=colour, width=2)
    if paths:
        _mark_start(draw, view.pixels(paths[-1][0][:1]))
    _footer(draw, view, [(colour, name) for _, colour, name in paths])
    encoded = io.BytesIO()
    picture.save(encoded, "PNG")
    return encoded.getvalue()


@dataclass(frozen=True)
class _View:
    """The part of the plane that the picture shows, and its scale."""

    left_m: float
    top_m: float
    width_px: int
    height_px: int
    px_per_m: float

    def pixels(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return (xy_m - [self.left_m, self.top_m]) * [self.px_per_m, -self.px_per_m]


def _view(
    cells: NDArray[np.int8],
    corner_m: NDArray[np.float64],
    resolution_m: float,
    paths: list[NDArray[np.float64]],
) -> _View:
    """Return the view that shows the whole known area and the paths."""
    rows, columns = np.nonzero(cells >= 0)
    known = np.column_stack([columns, rows]) * resolution_m + corner_m
    shown = np.concatenate([known, known + resolution_m, *paths])
    if len(shown) == 0:
        shown = np.zeros((1, 2))
    low, high = shown.min(axis=0) - BORDER_M, shown.max(axis=0) + BORDER_M
    longer_m = float((high - low).max())
    px_per_m = float(np.clip(1 / resolution_m, SMALLEST_PX / longer_m, LARGEST_PX / longer_m))
    width, height = np.ceil((high - low) * px_per_m).astype(int)
    return _View(float(low[0]), float(high[1]), max(int(width), 300), int(height), px_per_m)


def _ground(
    cells: NDArray[np.int8], corner_m: NDArray[np.float64], resolution_m: float, view: _View
) -> Image.Image:
    """Return the map, cut and scaled to the view. A thin wall stays dark where the picture is smaller."""
    shades = np.where(cells < 0, UNKNOWN, 255 - np.clip(cells, 0, 100).astype(int) * 255 // 100).astype(
        np.uint8
    )
    if shades.size == 0:
        shades = np.full((1, 1), UNKNOWN, np.uint8)
    per_pixel = 1 / (view.px_per_m * resolution_m)  # cells
    left = (view.left_m - corner_m[0]) / resolution_m
    top = len(shades) - (view.top_m - corner_m[1]) / resolution_m
    shrunk = int(per_pixel)
    flipped = Image.fromarray(shades[::-1].copy())
    if shrunk > 1:
        flipped = flipped.reduce(shrunk)
        per_pixel, left, top = per_pixel / shrunk, left / shrunk, top / shrunk
    return flipped.transform(
        (view.width_px, view.height_px),
        Image.Transform.AFFINE,
        (per_pixel, 0, left, 0, per_pixel, top),
        Image.Resampling.NEAREST,
        fillcolor=UNKNOWN,
    ).convert("RGB")


def _mark_start(draw: ImageDraw.ImageDraw, start_px: NDArray[np.float64]) -> None:
    for x, y in start_px:
        draw.ellipse((x - 5, y - 5, x + 5, y + 5), outline=INK, width=2)


def _footer(draw: ImageDraw.ImageDraw, view: _View, names: list[tuple[tuple[int, int, int], str]]) -> None:
    """Draw the scale bar and the legend below the map."""
    font = ImageFont.load_default()
    middle = view.height_px + FOOTER_PX // 2
    fitting = [length for length in BAR_LENGTHS_M if length * view.px_per_m < WIDEST_BAR * view.width_px]
    bar_m = fitting[-1] if fitting else BAR_LENGTHS_M[0]
    end = 10 + bar_m * view.px_per_m
    draw.line((10, middle, end, middle), fill=INK, width=3)
    for x in (10.0, end):
        draw.line((x, middle - 5, x, middle + 5), fill=INK, width=3)
    draw.text((end + 8, middle - 6), f"{bar_m:g} m", fill=INK, font=font)
    x = end + 60
    for colour, name in names:
        draw.line((x, middle, x + 24, middle), fill=colour, width=3)
        draw.text((x + 30, middle - 6), name, fill=INK, font=font)
        x += 44 + draw.textlength(name, font=font)
    if names:
        draw.ellipse((x + 2, middle - 5, x + 12, middle + 5), outline=INK, width=2)
        draw.text((x + 18, middle - 6), "start", fill=INK, font=font)
