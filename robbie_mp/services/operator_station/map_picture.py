"""An occupancy grid as a picture, and where in the map it lies."""

import io
import json
import math

import numpy as np
from PIL import Image as PillowImage

from robbie_mp.messages import OccupancyGrid
from robbie_mp.services.operator_station.pictures import NoPicture, Picture

PLACE_HEADER = "X-Robbie-Map"
UNKNOWN = 170
"""Grey of cells of which nothing is known; free ones are white, occupied ones black."""
MOST_PIXELS = 4_000_000
"""Of larger maps every second, third … cell is shown."""
GREYS = np.full(256, UNKNOWN, np.uint8)
"""By a cell's value as an unsigned byte: 0 to 100 %; -1 and all others: unknown."""
GREYS[:101] = np.round(255 - 2.55 * np.arange(101))


def draw_grid(grid: OccupancyGrid) -> Picture:
    """Return a grid as PNG, the largest y at the top, and its place in a header.

    The header is JSON: x and y (m) of the corner of the first cell, yaw (rad) of the grid, width and height
    (m) of the picture; so both are of the same map however late they come.

    Raises:
        NoPicture: it has no cells, or not as many as its size says.
    """
    info = grid.info
    rows, columns = info.height, info.width
    if not rows or not columns or len(grid.data) != rows * columns or not info.resolution > 0:
        raise NoPicture(f"a map of {columns} x {rows} cells of {info.resolution} m, with {len(grid.data)}")
    every = math.ceil(math.sqrt(rows * columns / MOST_PIXELS))
    cells = grid.data.view(np.uint8).reshape(rows, columns)[::every, ::every]
    encoded = io.BytesIO()
    picture = PillowImage.fromarray(np.ascontiguousarray(GREYS[cells][::-1]))
    picture.save(encoded, "PNG", compress_level=1)
    place = {
        "x_m": info.origin.position.x,
        "y_m": info.origin.position.y,
        "yaw_rad": info.origin.orientation.yaw,
        "width_m": picture.width * every * info.resolution,
        "height_m": picture.height * every * info.resolution,
    }
    return Picture(encoded.getvalue(), "image/png", {PLACE_HEADER: json.dumps(place)})
