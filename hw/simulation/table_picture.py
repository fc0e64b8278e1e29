"""Colour pictures of a table and what stands on it, as the colour camera beside a depth camera takes them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.simulation.depth_camera import DepthView
from robbie_robots.hw.simulation.object_prints import ObjectPrint
from robbie_robots.hw.simulation.solid import Floats, Placed

Pixels = NDArray[np.uint8]

FLOOR, NOTHING = (124, 126, 128), (214, 222, 230)
FRONT_M = 0.01
"""What is behind has coarse depths: an object this far behind them is still seen."""
SAMPLES = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
"""Places in each pixel, in pixels from its middle, whose mean is the pixel's colour."""
NOISE_TABLE = 1 << 20


class Printed(NamedTuple):
    """An object and what is printed on it."""

    placed: Placed
    print: ObjectPrint


class TablePictures:
    """Takes pictures from the place of a depth camera, with the same field of view.

    Objects are drawn in full; all behind them is drawn from the coarse view of the depth camera in plain
    colours, which is much faster.

    Args:
        geometry: the camera's projection.
        noise: standard deviation of pixel values.
        light: brightness, 1 in full light.
        seed: random seed of the noise.
    """

    def __init__(
        self, geometry: CameraGeometry, noise: float = 2.0, light: float = 1.0, seed: int = 0
    ) -> None:
        self.geometry = geometry
        self._light = light
        self._random = np.random.default_rng(seed)
        self._noise = np.rint(self._random.normal(0.0, noise, NOISE_TABLE)).astype(np.int16)

    def capture(
        self, pose: Floats, behind: DepthView, colours: Sequence[Sequence[int]], objects: Sequence[Printed]
    ) -> Pixels:
        """Return a picture: (height, width, 3), red, green, blue.

        Args:
            pose: X_AC, the camera's pose, (4, 4): z ahead, x to the right, y down.
            behind: what the depth camera sees without the objects.
            colours: of each shape in it: red, green, blue.
            objects: the objects.
        """
        size = (self.geometry.width, self.geometry.height)
        coarse = np.array([*colours, FLOOR, NOTHING], np.uint8)[behind.shapes]
        picture = np.array(Image.fromarray(coarse).resize(size, Image.Resampling.BILINEAR), np.float32)
        away_m = [float(np.linalg.norm(one.placed.pose[:3, 3] - pose[:3, 3])) for one in objects]
        for place in np.argsort(away_m)[::-1]:  # the nearest last
            self._draw(picture, pose, behind, objects[place])
        picture *= self._light
        return self._with_noise(picture)

    def _draw(self, picture: NDArray[np.float32], pose: Floats, behind: DepthView, one: Printed) -> None:
        rectangle = self._rectangle(pose, one.placed)
        if rectangle is None:
            return
        rows, columns = rectangle
        turn = one.placed.pose[:3, :3]
        origin = (pose[:3, 3] - one.placed.pose[:3, 3]) @ turn
        coarse_rows, coarse_columns = behind.depths_m.shape
        limits = behind.depths_m[
            (rows * coarse_rows // self.geometry.height)[:, None],
            (columns * coarse_columns // self.geometry.width)[None],
        ].ravel()
        seen = np.zeros((len(rows) * len(columns), 3))
        counts = np.zeros(len(seen))
        (centre_x, centre_y), focal = self.geometry.centre_px, self.geometry.focal_length_px
        for right, down in SAMPLES:
            x, y = np.meshgrid((columns + right - centre_x) / focal, (rows + down - centre_y) / focal)
            rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ pose[:3, :3].T @ turn
            ranges = one.placed.solid.ranges_m(origin, rays)
            here = np.flatnonzero(ranges < limits + FRONT_M)
            seen[here] += one.print.colours(origin + rays[here] * ranges[here, None], turn)
            counts[here] += 1
        part = picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        share = (counts / len(SAMPLES)).reshape(part.shape[:2])[..., None]
        part[:] = part * (1 - share) + seen.reshape(part.shape) / len(SAMPLES)

    def _rectangle(self, pose: Floats, placed: Placed) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
        """Return the rows and the columns of the picture in which a shape may be seen."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        corners = (signs * placed.solid.size_m / 2) @ placed.pose[:3, :3].T + placed.pose[:3, 3]
        seen = (corners - pose[:3, 3]) @ pose[:3, :3]
        if (seen[:, 2] <= 0.05).any():
            return None
        places = seen[:, :2] / seen[:, 2:] * self.geometry.focal_length_px + self.geometry.centre_px
        size = (self.geometry.width, self.geometry.height)
        least = np.maximum(np.floor(places.min(axis=0)), 0).astype(int)
        most = np.minimum(np.ceil(places.max(axis=0)), np.array(size) - 1).astype(int)
        if (least > most).any():
            return None
        return np.arange(least[1], most[1] + 1), np.arange(least[0], most[0] + 1)

    def _with_noise(self, picture: NDArray[np.float32]) -> Pixels:
        begin = int(self._random.integers(NOISE_TABLE))
        noise = np.resize(np.roll(self._noise, begin), picture.size).reshape(picture.shape)
        return np.asarray(np.clip(picture + noise, 0, 255), np.uint8)
