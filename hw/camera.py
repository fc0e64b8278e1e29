"""The interface of cameras."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class CameraGeometry:
    """The projection and mounting position of a camera without distortion.

    Attributes:
        width: number of columns of the image.
        height: number of rows of the image.
        field_of_view_rad: horizontal angle from the left edge of the image to the right edge.
        mount_m: x, y, z of the optical centre in the robot's frame; a pan-tilt unit turns about it.
    """

    width: int = 320
    height: int = 240
    field_of_view_rad: float = math.radians(60.0)
    mount_m: tuple[float, float, float] = (0.1, 0.0, 0.35)

    @property
    def focal_length_px(self) -> float:
        """Return the focal length in pixels; it is the same for columns and rows."""
        return self.width / 2 / math.tan(self.field_of_view_rad / 2)

    @property
    def centre_px(self) -> tuple[float, float]:
        """Return column and row of the principal point; (0, 0) is the middle of the first pixel."""
        return (self.width - 1) / 2, (self.height - 1) / 2


@dataclass(frozen=True)
class CameraFrame:
    """One image.

    Attributes:
        stamp_s: time of exposure, on the device's clock.
        pixels: (height, width, 3) uint8 red, green, blue; for a thermal camera (height, width) uint16 in
            hundredths of a kelvin.
    """

    stamp_s: float
    pixels: NDArray[np.uint8] | NDArray[np.uint16]


class Camera(ABC):
    """A camera that takes an image on request."""

    @property
    @abstractmethod
    def geometry(self) -> CameraGeometry:
        """Return the camera's projection and mounting position."""

    @abstractmethod
    def capture(self) -> CameraFrame:
        """Return the newest image."""
