"""The map as a picture that lies on the floor."""

import base64
import io
from typing import NamedTuple

import numpy as np
from PIL import Image

from robbie_mp.messages import OccupancyGrid

UNKNOWN, SHADES = 0, 101
"""Places in the palette: unknown, then 0 free … 100 occupied."""
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
    shown = (np.clip(cells, -1, 100).astype(np.int16) + 1).astype(np.uint8)
    picture = Image.fromarray(shown.reshape(info.height, info.width))
    picture.putpalette(PALETTE)
    file = io.BytesIO()
    picture.save(file, "PNG", compress_level=1, transparency=UNKNOWN)
    turn = info.origin.orientation
    yaw_rad = float(np.arctan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2)))
    return Floor(
        "data:image/png;base64," + base64.b64encode(file.getvalue()).decode(),
        info.width * info.resolution,
        info.height * info.resolution,
        (info.origin.position.x, info.origin.position.y, yaw_rad),
    )
