"""The shape of a board in the image tells in which direction it faces."""

import math

import numpy as np
import pytest

from robbie_robots.workers.numbers.board_pose import board_facing
from robbie_robots.workers.numbers.quadrangles import Quadrangle

FOCAL_PX, CENTRE_PX = 550.0, (320.0, 200.0)


def image_of(x_m: float, y_m: float, facing_rad: float) -> Quadrangle:
    """A board of 0.5 m whose middle is 0.2 m above the camera, which looks along x."""
    corners = []
    for aside, above in ((-0.25, 0.45), (0.25, 0.45), (0.25, -0.05), (-0.25, -0.05)):
        # Seen from the front, the board's right is to the left of its normal, seen from above.
        x = x_m - math.sin(facing_rad) * aside
        y = y_m + math.cos(facing_rad) * aside
        corners.append((CENTRE_PX[0] - FOCAL_PX * y / x, CENTRE_PX[1] - FOCAL_PX * above / x))
    return Quadrangle(np.array(corners, np.float32))


@pytest.mark.parametrize("y_m", [-0.8, 0.0, 0.8])
@pytest.mark.parametrize("slant_deg", [-78, -50, -25, 25, 50, 78])
def test_facing_is_measured_from_the_direction_to_the_camera(y_m: float, slant_deg: int) -> None:
    towards_rad = math.atan2(-y_m, -2.0)
    quadrangle = image_of(2.0, y_m, towards_rad + math.radians(slant_deg))
    assert math.degrees(board_facing(quadrangle, FOCAL_PX, CENTRE_PX)) == pytest.approx(slant_deg, abs=4)
