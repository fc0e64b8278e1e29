"""The rays through the pixels of a camera that is tilted and turned, but never leans to a side."""

import numpy as np
from numpy.typing import NDArray

from hw.camera import CameraGeometry

Floats = NDArray[np.float32]


class ViewRays:
    """Where the pixels of a tilted camera look, before it is turned about the vertical axis.

    What stands upright is hit by all rays of one bearing at the same distance over the floor. So distances
    are needed for a few hundred bearings only, and each pixel uses those of its nearest bearing.

    Args:
        geometry: the camera.
        tilt_rad: below the horizon.

    Attributes:
        bearings_rad: (B,), to the left of straight ahead.
        bearing_of: (height, width), index of each pixel's bearing.
        cos, sin: (height, width), of each pixel's own bearing.
        slope: (height, width), how much a ray rises for each metre over the floor.
    """

    def __init__(self, geometry: CameraGeometry, tilt_rad: float) -> None:
        centre_x, centre_y = geometry.centre_px
        left = (centre_x - np.arange(geometry.width, dtype=np.float32)) / np.float32(geometry.focal_length_px)
        up = (centre_y - np.arange(geometry.height, dtype=np.float32)) / np.float32(geometry.focal_length_px)
        cos, sin = np.float32(np.cos(tilt_rad)), np.float32(np.sin(tilt_rad))
        # A rotation about the axis to the left; one column for all columns of the image.
        ahead, rise = (cos + sin * up)[:, None], (cos * up - sin)[:, None]
        over_floor = np.hypot(ahead, left)
        self.cos: Floats = ahead / over_floor
        self.sin: Floats = left / over_floor
        self.slope: Floats = rise / over_floor
        bearings = np.arctan2(left, np.broadcast_to(ahead, over_floor.shape))
        least, most = float(bearings.min()), float(bearings.max())
        # Half a pixel from bearing to bearing where pixels are narrowest, but not too many in all.
        count = min(2 * geometry.width, int((most - least) * geometry.focal_length_px * 2) + 2)
        self.bearings_rad: NDArray[np.float64] = np.linspace(least, most, count)
        step = (most - least) / (count - 1)
        self.bearing_of = np.rint((bearings - np.float32(least)) / np.float32(step)).astype(np.intp)
