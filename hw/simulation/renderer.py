"""Draws an arena as a camera sees it: walls, floor, and the pictures on the walls."""

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.hanging import Hanging, HangingView
from robbie_robots.hw.simulation.view_rays import ViewRays

Values = NDArray[Any]

TILE_M = 0.5
SKIRTING_M = 0.06


class Paint(Protocol):
    """The appearance of surfaces, as values of one kind: colours or temperatures."""

    def walls(self, surfaces: NDArray[np.intp], points_m: Values, ranges_m: Values) -> Values:
        """Return the values of walls at the points where the camera sees them.

        Args:
            surfaces: (B,), index of the surface in the arena.
            points_m: (B, 2), arena frame.
            ranges_m: (B,), distance from the eye.

        Returns:
            (2 B, …), first the values of the walls, then those of their skirting.
        """

    def rest(self) -> Values:
        """Return (3, …): the values of the floor's two kinds of tiles, and of the area above the walls."""


class Renderer:
    """Makes images of an arena.

    Args:
        geometry: the camera.
        paint: the appearance of surfaces.
    """

    def __init__(self, geometry: CameraGeometry, paint: Paint) -> None:
        self._geometry = geometry
        self._paint = paint
        self._rays = ViewRays(geometry, 0.0)
        self._tilt_rad = 0.0

    def render(
        self, arena: Arena, robot: Pose, direction: tuple[float, float], hangings: list[Hanging]
    ) -> Values:
        """Return what the camera sees: (height, width, …).

        Args:
            arena: the world.
            robot: pose of the robot that carries the camera, arena frame.
            direction: pan and tilt of the camera on the robot, rad.
            hangings: the pictures on the walls.
        """
        pan_rad, tilt_rad = direction
        if tilt_rad != self._tilt_rad:
            self._rays, self._tilt_rad = ViewRays(self._geometry, tilt_rad), tilt_rad
        x, y, _ = self._geometry.mount_m
        eye = robot.plus(Pose(x, y, pan_rad))
        ranges_m, surfaces = self._ranges(arena, eye)
        image = self._surroundings(arena, eye, ranges_m, surfaces)
        view = HangingView(self._geometry, self._rays, tilt_rad, eye)
        # Nearer pictures cover farther ones.
        for hanging in sorted(hangings, key=lambda one: -math.dist(eye[:2], (one.spot.x_m, one.spot.y_m))):
            view.draw(image, hanging, ranges_m)
        return image

    def _ranges(self, arena: Arena, eye: Pose) -> tuple[Values, NDArray[np.intp]]:
        return arena.hits(eye.x_m, eye.y_m, self._rays.bearings_rad + eye.heading_rad)

    def _surroundings(self, arena: Arena, eye: Pose, ranges_m: Values, surfaces: NDArray[np.intp]) -> Values:
        """Draw walls, floor and the area above the walls, with one table look-up for each pixel."""
        rays, eye_z = self._rays, np.float32(self._geometry.mount_m[2])
        directions = rays.bearings_rad + eye.heading_rad
        points = np.stack([np.cos(directions), np.sin(directions)], axis=1) * ranges_m[:, None] + eye[:2]
        table = np.concatenate([self._paint.walls(surfaces, points, ranges_m), self._paint.rest()])
        count = len(ranges_m)
        height = ranges_m.astype(np.float32)[rays.bearing_of]
        height *= rays.slope
        height += eye_z
        entry = np.where(height < SKIRTING_M, rays.bearing_of + np.int32(count), rays.bearing_of)
        entry[height > arena.wall_height_m] = 2 * count + 2
        floor = np.flatnonzero(height.ravel() < 0.0)
        entry.ravel()[floor] = 2 * count + self._tiles(eye, floor)
        image: Values = table.take(entry, axis=0)  # faster than table[entry]
        return image

    def _tiles(self, eye: Pose, pixels: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return 0 or 1 for each pixel that shows the floor, as on a chessboard."""
        rays = self._rays
        distance = -np.float32(self._geometry.mount_m[2]) / rays.slope.ravel()[pixels]
        ahead, left = distance * rays.cos.ravel()[pixels], distance * rays.sin.ravel()[pixels]
        cos, sin = np.float32(math.cos(eye.heading_rad)), np.float32(math.sin(eye.heading_rad))
        column = np.floor((ahead * cos - left * sin + np.float32(eye.x_m)) / np.float32(TILE_M))
        row = np.floor((ahead * sin + left * cos + np.float32(eye.y_m)) / np.float32(TILE_M))
        colour: NDArray[np.intp] = (column + row).astype(np.intp) & 1
        return colour
