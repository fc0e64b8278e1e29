"""The map as a picture that lies on the floor."""

import base64
import io
import math
from typing import NamedTuple

import numpy as np
from PIL import Image

from robbie_mp.messages import OccupancyGrid

UNKNOWN, SHADES = 0, 101
"""Places in the palette: unknown, then 0 free … 100 occupied."""
MOST_PIXELS = 4_000_000
"""Of larger maps every second, third … cell is shown."""
PALETTE = [0, 0, 0, *(level for value in range(SHADES) for level in 3 * [235 - 2 * value])]


class Floor(NamedTuple):
    """The picture, and where it lies."""

    url: str
    width_m: float
    height_m: float
    corner: tuple[float, float, float]
    """Of cell (0, 0): x, y, m, and yaw, rad; in the map's frame."""


def floor_of(grid: OccupancyGrid) -> Floor | None:
    """Draw a map; None if it has no cells."""
    info = grid.info
    cells = np.asarray(grid.data)
    if not len(cells) or len(cells) != info.width * info.height:
        return None
    every = math.ceil(math.sqrt(len(cells) / MOST_PIXELS))
    cells = cells.reshape(info.height, info.width)[::every, ::every]
    shown = (np.clip(cells, -1, 100).astype(np.int16) + 1).astype(np.uint8)
    picture = Image.fromarray(shown)
    picture.putpalette(PALETTE)
    file = io.BytesIO()
    picture.save(file, "PNG", compress_level=1, transparency=UNKNOWN)
    turn = info.origin.orientation
    yaw_rad = float(np.arctan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2)))
    return Floor(
        "data:image/png;base64," + base64.b64encode(file.getvalue()).decode(),
        picture.width * every * info.resolution,
        picture.height * every * info.resolution,
        (info.origin.position.x, info.origin.position.y, yaw_rad),
    )
