"""The rays through the pixels of a camera that pans and tilts, but does not roll."""

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraGeometry

Floats = NDArray[np.float32]


class ViewRays:
    """Directions of the pixels of a tilted camera, before it pans.

    All rays of one bearing hit an upright surface at the same horizontal distance. So the renderer computes
    distances only for a few hundred bearings, and each pixel uses that of its nearest bearing.

    Args:
        geometry: the camera.
        tilt_rad: tilt below the horizon.

    Attributes:
        bearings_rad: (B,), bearings, positive to the left of straight ahead.
        bearing_of: (height, width), index of each pixel's nearest bearing.
        cos, sin: (height, width), cosine and sine of each pixel's exact bearing.
        slope: (height, width), rise of each ray per metre of horizontal distance.
    """

    def __init__(self, geometry: CameraGeometry, tilt_rad: float) -> None:
        centre_x, centre_y = geometry.centre_px
        left = (centre_x - np.arange(geometry.width, dtype=np.float32)) / np.float32(geometry.focal_length_px)
        up = (centre_y - np.arange(geometry.height, dtype=np.float32)) / np.float32(geometry.focal_length_px)
        cos, sin = np.float32(np.cos(tilt_rad)), np.float32(np.sin(tilt_rad))
        # Rotate about the axis to the left. One column holds for all columns of the image.
        ahead, rise = (cos + sin * up)[:, None], (cos * up - sin)[:, None]
        over_floor = np.hypot(ahead, left)
        self.cos: Floats = ahead / over_floor
        self.sin: Floats = left / over_floor
        self.slope: Floats = rise / over_floor
        bearings = np.arctan2(left, np.broadcast_to(ahead, over_floor.shape))
        least, most = float(bearings.min()), float(bearings.max())
        # Bearings are half a pixel apart where pixels are narrowest, up to a maximum number.
        count = min(2 * geometry.width, int((most - least) * geometry.focal_length_px * 2) + 2)
        self.bearings_rad: NDArray[np.float64] = np.linspace(least, most, count)
        step = (most - least) / (count - 1)
        self.bearing_of = np.rint((bearings - np.float32(least)) / np.float32(step)).astype(np.int32)
