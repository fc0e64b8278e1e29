"""A simulated depth camera that sees boxes and cylinders."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.simulation.solid import Placed

MAX_MM = 2**16 - 1
ON_FLOOR, ON_NOTHING = -2, -1
"""Instead of the number of a shape."""


class DepthView(NamedTuple):
    """What lies in the direction of each pixel.

    Attributes:
        depths_m: (height, width), exact depths; inf: nothing.
        shapes: (height, width), the number of the shape, ON_FLOOR or ON_NOTHING.
    """

    depths_m: NDArray[np.float64]
    shapes: NDArray[np.intp]


class SimulatedDepthCamera:
    """A depth camera with noise that grows with the square of the distance, as that of stereo cameras does.

    Args:
        geometry: its projection; the mount is not used.
        noise_m: standard deviation of a depth of 1 m.
        range_m: the least and the greatest depth that it measures.
        seed: random seed of the noise.
    """

    def __init__(
        self,
        geometry: CameraGeometry,
        noise_m: float = 0.002,
        range_m: tuple[float, float] = (0.2, 3.0),
        seed: int = 0,
    ) -> None:
        self.geometry = geometry
        self._noise_m, self._range_m = noise_m, range_m
        self._random = np.random.default_rng(seed)
        columns, rows = np.meshgrid(np.arange(geometry.width), np.arange(geometry.height))
        centre_x, centre_y = geometry.centre_px
        focal = geometry.focal_length_px
        # Their z is 1, so the length of a ray in units of its direction is the depth.
        self._rays = np.stack(
            [(columns - centre_x) / focal, (rows - centre_y) / focal, np.ones(columns.shape)], axis=-1
        ).reshape(-1, 3)

    def capture(self, pose: NDArray[np.float64], seen: Iterable[Placed]) -> NDArray[np.uint16]:
        """Return a depth image: (height, width), mm; 0: nothing was measured.

        Args:
            pose: X_AC, the camera's pose, (4, 4): z ahead, x to the right, y down.
            seen: what is there besides the floor.
        """
        return self.measured(self.view(pose, seen).depths_m)

    def view(
        self, pose: NDArray[np.float64], seen: Iterable[Placed], behind: DepthView | None = None
    ) -> DepthView:
        """Return what the camera sees, without noise and limits of range.

        Args:
            pose: X_AC, the camera's pose, (4, 4).
            seen: what is there besides the floor.
            behind: a view from the same pose, to which these shapes are added.
        """
        rays = self._rays @ pose[:3, :3].T
        if behind is None:
            with np.errstate(divide="ignore"):
                floor = -pose[2, 3] / rays[:, 2]
            is_floor = rays[:, 2] < 0.0
            depths = np.where(is_floor, floor, np.inf)
            shapes = np.where(is_floor, ON_FLOOR, ON_NOTHING)
        else:
            depths, shapes = behind.depths_m.ravel().copy(), behind.shapes.ravel().copy()
        for number, shape in enumerate(seen):
            wanted = np.flatnonzero(self._towards(pose, shape))
            if not len(wanted):
                continue
            origin = (pose[:3, 3] - shape.pose[:3, 3]) @ shape.pose[:3, :3]
            ranges = shape.solid.ranges_m(origin, rays[wanted] @ shape.pose[:3, :3])
            is_nearer = ranges < depths[wanted]
            depths[wanted[is_nearer]], shapes[wanted[is_nearer]] = ranges[is_nearer], number
        size = (self.geometry.height, self.geometry.width)
        return DepthView(depths.reshape(size), shapes.reshape(size))

    def measured(self, depths_m: NDArray[np.float64]) -> NDArray[np.uint16]:
        """Return the depth image of exact depths (height, width): mm, with noise."""
        least, most = self._range_m
        depths = np.where((depths_m >= least) & (depths_m <= most), depths_m, 0.0)
        depths += self._random.normal(0.0, self._noise_m, depths.shape) * depths**2
        return np.clip(np.rint(depths * 1000.0), 0, MAX_MM).astype(np.uint16)

    def _towards(self, pose: NDArray[np.float64], shape: Placed) -> NDArray[np.bool_]:
        """Return which rays may hit a shape: those through the sphere around it."""
        centre = (shape.pose[:3, 3] - pose[:3, 3]) @ pose[:3, :3]
        along = self._rays @ centre
        apart = centre @ centre - shape.radius_m**2
        squares = np.einsum("ij,ij->i", self._rays, self._rays)
        return np.asarray((apart <= 0) | ((along > 0) & (along * along >= apart * squares)))
