"""Courses for races: a closed way between two boundaries, with obstacles."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena

Array = NDArray[np.float64]
STATIONS = 240
EDGE_M = 1.0
"""Space around a course."""


@dataclass(frozen=True)
class CourseWishes:
    """The properties of a course.

    Attributes:
        radius_m: mean distance of the way from the middle.
        width_m: distance between the boundaries.
        waviness: how much the way winds; 0: a circle.
        obstacles: how many round obstacles stand on it.
        passage_m: at least as much way is left beside an obstacle.
    """

    radius_m: float = 5.0
    width_m: float = 1.8
    waviness: float = 0.12
    obstacles: int = 6
    passage_m: float = 0.9


@dataclass(frozen=True)
class Course:
    """A course.

    Attributes:
        arena: its boundaries and obstacles. The robot starts on the way, looking along it.
        middle: (N, 2), m, arena frame: the middle of the way, counter-clockwise, from the start on.
        normals: (N, 2): to the left of the way there.
        width_m: distance between the boundaries.
    """

    arena: Arena
    middle: Array
    normals: Array
    width_m: float


def random_course(seed: int) -> Course:
    """Make a course. The same seed gives the same one."""
    wishes = CourseWishes()
    random = np.random.default_rng(seed)
    angle = np.linspace(0.0, 2 * math.pi, STATIONS, endpoint=False)
    factor = np.ones(STATIONS)
    for waves in (2, 3, 4, 5):
        share = wishes.waviness * random.uniform(0.3, 1.0) / math.sqrt(waves)
        factor += share * np.cos(waves * angle + random.uniform(0, 2 * math.pi))
    way = np.column_stack((np.cos(angle), np.sin(angle))) * (wishes.radius_m * factor)[:, None]
    along = np.roll(way, -1, axis=0) - np.roll(way, 1, axis=0)
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    normals = np.column_stack((-along[:, 1], along[:, 0]))
    half_m = wishes.width_m / 2
    way = way - (way - half_m * np.abs(normals)).min(axis=0) + EDGE_M
    segments = np.concatenate([_closed(way + side * half_m * normals) for side in (-1, 1)])
    circles = _obstacles(random, way, normals, wishes)
    size = (way + half_m * np.abs(normals)).max(axis=0) + EDGE_M
    start = Pose(float(way[0, 0]), float(way[0, 1]), math.atan2(along[0, 1], along[0, 0]))
    return Course(
        Arena(segments, circles, start, float(size[0]), float(size[1])), way, normals, wishes.width_m
    )


def as_yaml(course: Course) -> str:
    """Return a course as an arena file: see `robbie_robots.hw.simulation.arena_file`."""
    arena, cell_m = course.arena, 0.25
    columns, rows = (math.ceil(size / cell_m) for size in (arena.width_m, arena.height_m))
    drawing = [["."] * columns for _ in range(rows)]
    drawing[0] = drawing[-1] = ["#"] * columns
    for line in drawing:
        line[0] = line[-1] = "#"
    column, row = int(arena.start.x_m / cell_m), int(arena.start.y_m / cell_m)
    drawing[rows - 1 - row][column] = "R"
    lines = [f"cell_m: {cell_m}", f"start_heading_rad: {arena.start.heading_rad:.4f}", "drawing: |"]
    lines += [f"  {''.join(line)}" for line in drawing]
    for key, shapes in (("segments", arena.segments), ("circles", arena.circles)):
        lines.append(f"{key}:")
        lines += [f"  - [{', '.join(f'{number:.3f}' for number in shape)}]" for shape in shapes]
    return "\n".join(lines) + "\n"


def _closed(points: Array) -> Array:
    """Return the closed line through points as segments: (N, 4)."""
    return np.concatenate([points, np.roll(points, -1, axis=0)], axis=1)


def _obstacles(random: np.random.Generator, way: Array, normals: Array, wishes: CourseWishes) -> Array:
    """Put obstacles on the way, in turn on one and the other side, none near the start."""
    circles = []
    for number in range(wishes.obstacles):
        share = (number + 0.7 + random.uniform(-0.15, 0.15)) / (wishes.obstacles + 0.4)
        station = int(share * STATIONS) % STATIONS
        radius_m = random.uniform(0.1, 0.2)
        # From the boundary inwards, as far as the passage allows.
        most_m = wishes.width_m - wishes.passage_m - radius_m
        offset_m = wishes.width_m / 2 - random.uniform(radius_m, max(radius_m, most_m))
        side = 1 if (number + int(random.integers(0, 2))) % 2 else -1
        circles.append([*(way[station] + side * offset_m * normals[station]), radius_m])
    return np.array(circles).reshape(-1, 3)
