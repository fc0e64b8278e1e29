"""The world of the simulated devices: walls as line segments, round obstacles as circles."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena_contents import (
    AppearingObstacle,
    ArenaPerson,
    ArenaVictim,
    HazardSign,
    NumberSign,
    Sheet,
    StandingObject,
    Table,
)
from robbie_robots.hw.simulation.doors import Door, door_leaves

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Arena:
    """A closed world in the plane; its frame has the origin at the lower left corner, x right, y up.

    Attributes:
        segments: (N, 4), m: x1, y1, x2, y2 of every piece of wall.
        circles: (M, 3), m: x, y, radius of every round obstacle.
        start: the robot's start pose.
        width_m: extent in x.
        height_m: extent in y.
        wall_height_m: height of walls and obstacles.
        victims: victims on the walls.
        signs: hazard signs on the walls.
        appearing: temporary obstacles; none of them is in `segments` and `circles`.
        numbers: boards with digits and other things; their posts are in `circles`.
        sheet: a sheet with an order of digits, held up at the start.
        tables: tables; their sides are in `segments`.
        objects: what stands on the tables at the start.
        people: people who walk; their legs are not in `circles`, because they move.
        doors: doors; their leaves are not in `segments`, because they turn.
    """

    segments: Array
    circles: Array
    start: Pose
    width_m: float
    height_m: float
    wall_height_m: float = 1.2
    victims: tuple[ArenaVictim, ...] = ()
    signs: tuple[HazardSign, ...] = ()
    appearing: tuple[AppearingObstacle, ...] = ()
    numbers: tuple[NumberSign, ...] = ()
    sheet: Sheet | None = None
    tables: tuple[Table, ...] = ()
    objects: tuple[StandingObject, ...] = ()
    people: tuple[ArenaPerson, ...] = ()
    doors: tuple[Door, ...] = ()

    def with_obstacles(self, indices: Iterable[int]) -> "Arena":
        """Return this arena with some of its temporary obstacles present.

        Args:
            indices: positions in `appearing`.
        """
        there = [self.appearing[index] for index in indices]
        return replace(
            self,
            segments=np.concatenate([self.segments, *(obstacle.segments for obstacle in there)]),
            circles=np.concatenate([self.circles, *(obstacle.circles for obstacle in there)]),
        )

    def with_doors(self, opened_rad: Iterable[float]) -> "Arena":
        """Return this arena with the leaves of its doors.

        Args:
            opened_rad: how far each of `doors` is open.
        """
        if not self.doors:
            return self
        return replace(self, segments=np.concatenate([self.segments, door_leaves(self.doors, opened_rad)]))

    def with_robots(self, places: Array, radius_m: float) -> "Arena":
        """Return this arena with other robots in it, as round obstacles.

        Args:
            places: (N, 2), m, where they are.
            radius_m: their radius.
        """
        if not len(places):
            return self
        return self.with_circles(np.column_stack([places, np.full(len(places), radius_m)]))

    def with_circles(self, circles: Array) -> "Arena":
        """Return this arena with more round obstacles.

        Args:
            circles: (N, 3), m: x, y, radius.
        """
        return replace(self, circles=np.concatenate([self.circles, circles])) if len(circles) else self

    def clearance_m(self, points: Array) -> Array:
        """Return the distance from points to the nearest surface of a wall or obstacle.

        Args:
            points: (..., 2), m, arena frame.

        Returns:
            (...), m; never negative, not even inside an obstacle.
        """
        points = np.asarray(points, dtype=np.float64)[..., None, :]
        begin, along = self.segments[:, :2], self.segments[:, 2:] - self.segments[:, :2]
        squared_length = np.maximum((along**2).sum(axis=1), 1e-12)
        fraction = np.clip(((points - begin) * along).sum(axis=-1) / squared_length, 0.0, 1.0)
        offset = points - (begin + fraction[..., None] * along)
        to_walls = np.sqrt((offset**2).sum(axis=-1).min(axis=-1, initial=np.inf))
        from_centres = np.sqrt(((points - self.circles[:, :2]) ** 2).sum(axis=-1))
        to_circles = np.abs(from_centres - self.circles[:, 2]).min(axis=-1, initial=np.inf)
        nearest: Array = np.minimum(to_walls, to_circles)
        return nearest

    def ranges_m(self, x_m: float, y_m: float, angles_rad: Array) -> Array:
        """Return the lengths of rays from one point to the first hit.

        Args:
            x_m: x of the rays' start, arena frame.
            y_m: y of the rays' start, arena frame.
            angles_rad: (N,), directions in the arena frame.

        Returns:
            (N,), m; +inf for a ray that hits nothing.
        """
        return self.hits(x_m, y_m, angles_rad)[0]

    def hits(self, x_m: float, y_m: float, angles_rad: Array) -> tuple[Array, NDArray[np.intp]]:
        """Return the lengths of rays from one point, and what they hit.

        Args:
            x_m: x of the rays' start, arena frame.
            y_m: y of the rays' start, arena frame.
            angles_rad: (N,), directions in the arena frame.

        Returns:
            (N,), m, +inf for a ray that hits nothing; and (N,), the index of what it hits in `segments`
            followed by `circles`.
        """
        directions = np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
        origin = np.array([x_m, y_m])
        ranges = np.concatenate(
            [
                _ranges_to_segments(origin, directions, self.segments),
                _ranges_to_circles(origin, directions, self.circles),
            ],
            axis=1,
        )
        nearest = ranges.argmin(axis=1)
        return ranges[np.arange(len(ranges)), nearest], nearest


def _ranges_to_segments(origin: Array, directions: Array, segments: Array) -> Array:
    """Solve origin + t * direction = begin + u * along by cross products: (rays, segments)."""
    begin, along = segments[:, :2] - origin, segments[:, 2:] - segments[:, :2]
    dx, dy = directions[:, :1], directions[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):  # a ray parallel to a wall hits nothing
        scale = 1.0 / (dx * along[:, 1] - dy * along[:, 0])
        t = (begin[:, 0] * along[:, 1] - begin[:, 1] * along[:, 0]) * scale
        u = (begin[:, 0] * dy - begin[:, 1] * dx) * scale
        # Extend each segment slightly, so that no ray passes between two walls that meet.
        hits = (t >= 0.0) & (u >= -1e-9) & (u <= 1.0 + 1e-9)
    return np.where(hits, t, np.inf)


def _ranges_to_circles(origin: Array, directions: Array, circles: Array) -> Array:
    """Solve |origin + t * direction - centre| = radius: (rays, circles)."""
    to_centre = circles[:, :2] - origin
    nearest = directions @ to_centre.T
    # Squared half of the chord; negative where the ray passes the circle.
    squared_half = circles[:, 2] ** 2 - (to_centre**2).sum(axis=1) + nearest**2
    half = np.sqrt(np.maximum(squared_half, 0.0))
    t = np.where(nearest - half >= 0.0, nearest - half, nearest + half)
    return np.where((squared_half >= 0.0) & (t >= 0.0), t, np.inf)
