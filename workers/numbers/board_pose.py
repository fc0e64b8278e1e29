"""In which direction a board faces, by its shape in the image.

The size of a board is not known, but that it is square is. So the perspective transform from a square to its
image gives the directions of the board's edges (Zhang, "A flexible new technique for camera calibration",
PAMI 2000, section 3.1).
"""

import math
from importlib import import_module
from typing import Any

import numpy as np

from robbie_robots.workers.numbers.quadrangles import Quadrangle

# Clockwise from the upper left, seen from the front: x to the right, y up.
SQUARE = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]], np.float32)
MAX_SLANT_RAD = math.radians(80)
"""No board can be read at a larger slant: a larger one is a small error of the corners."""


def board_facing(quadrangle: Quadrangle, focal_px: float, centre_px: tuple[float, float]) -> float:
    """Return the angle over the ground from the direction to the camera to that of the board's front, rad.

    Positive is counter-clockwise, seen from above; at most MAX_SLANT_RAD.
    """
    cv2: Any = import_module("cv2")
    rays = ((quadrangle.corners_px - np.array(centre_px)) / focal_px).astype(np.float32)
    right, up, middle = cv2.getPerspectiveTransform(SQUARE, rays).T
    normal = np.cross(right, up)
    # In the optical frame, x is to the right and z ahead: angles from above, counter-clockwise.
    facing_rad, view_rad = math.atan2(-normal[0], normal[2]), math.atan2(middle[0], -middle[2])
    slant_rad = math.remainder(facing_rad - view_rad, math.tau)
    return min(max(slant_rad, -MAX_SLANT_RAD), MAX_SLANT_RAD)
