"""How a camera projects: pixels from directions, and back.

The model is that of ROS's camera_calibration (OpenCV's `plumb_bob` and `rational_polynomial`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_mp.base.errors import RobbieError

if TYPE_CHECKING:
    from robbie_mp.messages import CameraInfo

DISTORTIONS = {"": 5, "plumb_bob": 5, "rational_polynomial": 8}
"""The known models of distortion, and how many of k1, k2, p1, p2, k3, k4, k5, k6 they have at most."""
BEYOND = 1.2
"""Lines are drawn up to this multiple of the distance from the picture's middle to its farthest corner."""
STEPS = 2000
MAX_SLOPE = 10.0
"""Maximum tangent of the angle between a direction and the optical axis."""
ITERATIONS = 50
MAX_ERROR_PX = 0.5
LEAST_AHEAD = 1e-6
NOWHERE = 1e9


class NoFloor(RobbieError):
    """A picture does not show where the floor is; the text is a sentence for an operator."""


@dataclass(frozen=True)
class CameraModel:
    """The projection of a camera. (0, 0) is the middle of the first pixel.

    Attributes:
        width: columns of its pictures.
        height: rows.
        focal_px: focal lengths for columns and rows.
        centre_px: column and row of the principal point.
        distortion: k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...] = (0.0,) * 8

    @classmethod
    def of(cls, info: CameraInfo) -> CameraModel:
        """Return the model that a camera tells.

        Raises:
            NoFloor: the camera is not calibrated, or in a way that is not known here.
        """
        numbers = [*info.k.tolist(), *info.d.tolist()]
        if not info.is_calibrated or not info.width or not info.height:
            raise NoFloor("the camera is not calibrated")
        if not all(map(math.isfinite, numbers)) or not (info.k[0] > 0.0 and info.k[4] > 0.0):
            raise NoFloor("the calibration of the camera is no projection")
        if max(info.binning_x, info.binning_y) > 1 or info.roi.width or info.roi.height:
            raise NoFloor("the camera sends only a part of its picture, or a smaller one")
        most = DISTORTIONS.get(info.distortion_model, 0)
        given = info.d.tolist() if info.d.any() else []
        if len(given) > most:
            raise NoFloor(f"the distortion of the camera, {info.distortion_model!r:.40}, is not known here")
        fx, _, cx, _, fy, cy = numbers[:6]
        distortion = (*given, *(0.0,) * (8 - len(given)))
        return cls(int(info.width), int(info.height), (fx, fy), (cx, cy), distortion)

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the pixels (N, 2) of points (N, 3) in the optical frame; NaN for those not in sight."""
        x, y, z = np.asarray(points, np.float64).reshape(-1, 3).T
        is_ahead = z > LEAST_AHEAD
        slopes = np.stack([x, y], axis=1) / np.where(is_ahead, z, 1.0)[:, None]
        in_sight = is_ahead & (np.hypot(*slopes.T) <= self.reach)
        pixels = self.distorted(slopes) * self.focal_px + self.centre_px
        return np.where(in_sight[:, None], pixels, np.nan)

    def ray(self, column: float, row: float) -> NDArray[np.float64]:
        """Return the direction (3,) in the optical frame of what a pixel shows.

        Raises:
            NoFloor: the calibration does not tell.
        """
        wanted = (np.array([column, row]) - self.centre_px) / self.focal_px
        slopes = wanted.copy()
        for _ in range(ITERATIONS):
            slopes = np.clip(slopes + wanted - self.distorted(slopes[None])[0], -MAX_SLOPE, MAX_SLOPE)
        error_px = (self.distorted(slopes[None])[0] - wanted) * self.focal_px
        if not np.abs(error_px).max() <= MAX_ERROR_PX or np.hypot(*slopes) > self.reach:
            raise NoFloor("the calibration of the camera does not hold for this part of its picture")
        return np.array([*slopes, 1.0])

    def distorted(self, slopes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where a lens brings directions (N, 2), which are given by their tangents."""
        k1, k2, p1, p2, k3, k4, k5, k6 = self.distortion
        x, y = slopes.T
        square = x * x + y * y
        with np.errstate(all="ignore"):  # of a calibration that is nonsense
            radial = 1 + square * (k1 + square * (k2 + square * k3))
            radial /= 1 + square * (k4 + square * (k5 + square * k6))
            right = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
            down = y * radial + 2 * p2 * x * y + p1 * (square + 2 * y * y)
        there: NDArray[np.float64] = np.stack([right, down], axis=1)
        return np.where(np.isfinite(there), there, NOWHERE)

    @cached_property
    def reach(self) -> float:
        """Greatest tangent of a direction that is drawn: beyond it, the distortion may fold back."""
        edges = np.array([[0.0, 0.0], [self.width, 0.0], [0.0, self.height], [self.width, self.height]])
        corner = np.hypot(*((edges - self.centre_px) / self.focal_px).T).max()
        slopes = np.linspace(0.0, MAX_SLOPE, STEPS)
        there = self.distorted(np.stack([slopes, np.zeros(STEPS)], axis=1))[:, 0]
        falls = np.flatnonzero(~(np.diff(there) > 0.0))
        last = falls[0] if len(falls) else STEPS - 1
        return float(slopes[min(last, int(np.searchsorted(there[: last + 1], BEYOND * corner)))])

    def described(self) -> dict[str, object]:
        """Return the model for a page, whose picture may have another size: in shares of width and height."""
        size = np.array([self.width, self.height])
        return {
            "focal": rounded(self.focal_px / size),
            "centre": rounded((np.array(self.centre_px) + 0.5) / size),
            "reach": round(self.reach, 4),
            "distortion": rounded(self.distortion) if any(self.distortion) else None,
        }


def rounded(numbers: ArrayLike) -> list[float]:
    """Return numbers for a page."""
    return [round(number, 5) for number in np.asarray(numbers, np.float64).ravel().tolist()]
