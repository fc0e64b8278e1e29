"""What every camera offers, whatever hardware is behind it."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class CameraGeometry:
    """A camera without distortion and where it sits.

    Attributes:
        width: columns of the image.
        height: rows of the image.
        field_of_view_rad: horizontal, from the left edge of the image to the right edge.
        mount_m: x, y, z of the camera's eye in the robot's frame; a pan-tilt unit turns it about this point.
    """

    width: int = 320
    height: int = 240
    field_of_view_rad: float = math.radians(60.0)
    mount_m: tuple[float, float, float] = (0.1, 0.0, 0.35)

    @property
    def focal_length_px(self) -> float:
        """Return the focal length in pixels, of columns and rows alike."""
        return self.width / 2 / math.tan(self.field_of_view_rad / 2)

    @property
    def centre_px(self) -> tuple[float, float]:
        """Return column and row where the optical axis meets the image; (0, 0) is a pixel's middle."""
        return (self.width - 1) / 2, (self.height - 1) / 2


@dataclass(frozen=True)
class CameraFrame:
    """One image.

    Attributes:
        stamp_s: when it was taken, in the time of the device's clock.
        pixels: (height, width, 3) uint8 red, green, blue; or of a thermal camera (height, width) uint16 in
            hundredths of a kelvin.
    """

    stamp_s: float
    pixels: NDArray[np.uint8] | NDArray[np.uint16]


class Camera(ABC):
    """A camera that takes an image when asked."""

    @property
    @abstractmethod
    def geometry(self) -> CameraGeometry:
        """Return how it projects and where it sits."""

    @abstractmethod
    def capture(self) -> CameraFrame:
        """Return the newest image."""
