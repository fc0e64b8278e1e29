"""Draws the pictures on walls into a camera's image."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena_contents import WallSpot
from robbie_robots.hw.simulation.texture import Texture
from robbie_robots.hw.simulation.view_rays import ViewRays

# A picture is visible if the ray reaches its wall, or ends at most this far in front of it.
BEFORE_WALL_M = 0.06
# If a corner of a picture is nearer than this to the plane of the eye, the whole image is searched for it.
NEAR_M = 0.05


@dataclass(frozen=True)
class Hanging:
    """A picture at a spot on a wall.

    Attributes:
        spot: position of the picture's anchor.
        texture: the picture's pixels.
    """

    spot: WallSpot
    texture: Texture


@dataclass(frozen=True)
class HangingView:
    """A camera's view of pictures from one place.

    Attributes:
        geometry: the camera.
        rays: the rays through its pixels.
        tilt_rad: angle of the optical axis below the horizon.
        eye: position of the eye in the plane, arena frame.
    """

    geometry: CameraGeometry
    rays: ViewRays
    tilt_rad: float
    eye: Pose

    def draw(self, image: NDArray[Any], hanging: Hanging, ranges_m: NDArray[np.float64]) -> None:
        """Draw the visible part of a picture into an image.

        Args:
            image: (height, width, …).
            hanging: the picture.
            ranges_m: (B,), distance to the walls at each bearing of the rays.
        """
        spot, eye = hanging.spot, self.eye
        cos, sin = math.cos(spot.facing_rad), math.sin(spot.facing_rad)
        before_m = cos * (eye.x_m - spot.x_m) + sin * (eye.y_m - spot.y_m)
        window = self._window(hanging) if before_m > 0.01 else None
        if window is None:
            return
        towards, distance, aside, above = self._on_plane(spot, before_m, window)
        texture = hanging.texture
        rows, columns = texture.opaque.shape
        row = np.floor(texture.anchor_row - above / texture.texel_m).astype(np.intp)
        column = np.floor(columns / 2 + aside / texture.texel_m).astype(np.intp)
        seen = (row >= 0) & (row < rows) & (column >= 0) & (column < columns) & (towards > 0.0)
        wall_m = ranges_m.astype(np.float32)[self.rays.bearing_of[window]]
        seen &= distance < wall_m + np.float32(BEFORE_WALL_M)
        seen[seen] = texture.opaque[row[seen], column[seen]]
        image[window][seen] = texture.values[row[seen], column[seen]]

    def _on_plane(self, spot: WallSpot, before_m: float, window: tuple[slice, slice]) -> Any:
        """Return where rays meet the plane of a picture.

        Returns:
            The rays' components towards the plane; their distances to it over the floor; and where they meet
            it: to the right of the spot (as seen from the front) and above the spot.
        """
        cos, sin = self.rays.cos[window], self.rays.sin[window]
        turn = spot.facing_rad - self.eye.heading_rad
        turn_cos, turn_sin = np.float32(math.cos(turn)), np.float32(math.sin(turn))
        towards = -(turn_cos * cos + turn_sin * sin)
        distance = np.float32(before_m) / np.maximum(towards, np.float32(1e-6))
        eye_aside = math.sin(spot.facing_rad) * (spot.x_m - self.eye.x_m)
        eye_aside -= math.cos(spot.facing_rad) * (spot.y_m - self.eye.y_m)
        aside = distance * (turn_cos * sin - turn_sin * cos) + np.float32(eye_aside)
        eye_above = self.geometry.mount_m[2] - spot.height_m
        above = distance * self.rays.slope[window] + np.float32(eye_above)
        return towards, distance, aside, above

    def _window(self, hanging: Hanging) -> tuple[slice, slice] | None:
        """Return the image's rows and columns that contain a picture; None if it is out of sight."""
        geometry = self.geometry
        ahead, left, above = _corners(hanging, self.eye)
        above -= geometry.mount_m[2]
        cos, sin = math.cos(self.tilt_rad), math.sin(self.tilt_rad)
        depth, up = ahead * cos - above * sin, ahead * sin + above * cos
        if depth.max() < NEAR_M:
            return None
        if depth.min() < NEAR_M:
            return slice(0, geometry.height), slice(0, geometry.width)
        centre_x, centre_y = geometry.centre_px
        columns = _around(centre_x - geometry.focal_length_px * left / depth, geometry.width)
        rows = _around(centre_y - geometry.focal_length_px * up / depth, geometry.height)
        return None if rows.start >= rows.stop or columns.start >= columns.stop else (rows, columns)


def _corners(hanging: Hanging, eye: Pose) -> NDArray[np.float64]:
    """Return a picture's corners: ahead of the eye, left of the eye and above the floor, (3, 4), m."""
    spot, texture = hanging.spot, hanging.texture
    rows, columns = texture.opaque.shape
    half_m = columns / 2 * texture.texel_m
    aside = np.array([-half_m, half_m, -half_m, half_m])
    top = spot.height_m + texture.anchor_row * texture.texel_m
    above = np.array([top, top, top - rows * texture.texel_m, top - rows * texture.texel_m])
    x = spot.x_m - math.sin(spot.facing_rad) * aside - eye.x_m
    y = spot.y_m + math.cos(spot.facing_rad) * aside - eye.y_m
    cos, sin = math.cos(eye.heading_rad), math.sin(eye.heading_rad)
    return np.stack([cos * x + sin * y, cos * y - sin * x, above])


def _around(places: NDArray[np.float64], size: int) -> slice:
    return slice(max(0, math.floor(places.min())), min(size, math.ceil(places.max()) + 1))
