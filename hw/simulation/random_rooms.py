"""Random buildings for trials, with rooms, doorways and furniture. A seed always gives the same building."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena, Array
from robbie_robots.hw.simulation.box_segments import box_segments

SMALLEST_ROOM_M = 2.4
DOOR_M = 1.1
FURNITURE_PER_M2 = 0.05
KEPT_FREE_M = 0.35  # between furniture and walls, so that a robot can pass

Segment = tuple[float, float, float, float]


def random_rooms(seed: int, width_m: float = 14.0, height_m: float = 10.0) -> Arena:
    """Make a building whose rooms are all connected. The start is a random free pose."""
    random = np.random.default_rng(seed)
    walls: list[Segment] = [(0.0, 0.0, width_m, 0.0), (width_m, 0.0, width_m, height_m)]
    walls += [(0.0, 0.0, 0.0, height_m), (0.0, height_m, width_m, height_m)]
    _divide((0.0, 0.0, width_m, height_m), walls, random)
    bare = Arena(np.array(walls, float), np.empty((0, 3)), Pose(0, 0, 0), width_m, height_m)
    boxes, circles = [], []
    for _ in range(int(FURNITURE_PER_M2 * width_m * height_m)):
        centre = random.random(2) * [width_m, height_m]
        half = random.uniform(0.15, 0.45, 2)
        # This also keeps the doorways open, because their middle is nearer than this to the end of a wall.
        if bare.clearance_m(centre) < np.hypot(*half) + KEPT_FREE_M + DOOR_M / 2:
            continue
        if random.random() < 0.6:
            boxes.append([*(centre - half), *(centre + half)])
        else:
            circles.append([*centre, half[0]])
    arena = Arena(
        np.concatenate([bare.segments, box_segments(np.array(boxes).reshape(-1, 4))]),
        np.array(circles).reshape(-1, 3),
        bare.start,
        width_m,
        height_m,
    )
    return Arena(arena.segments, arena.circles, _start(arena, boxes, random), width_m, height_m)


def _divide(room: Segment, walls: list[Segment], random: np.random.Generator) -> None:
    """Divide a room by a wall with a doorway, and divide its parts again until they are small."""
    x1, y1, x2, y2 = room
    along_x = (x2 - x1) > (y2 - y1)
    low, high = (x1, x2) if along_x else (y1, y2)
    begin, end = (y1, y2) if along_x else (x1, x2)
    if high - low < 2 * SMALLEST_ROOM_M or (high - low < 6.0 and random.random() < 0.25):
        return
    at = random.uniform(low + SMALLEST_ROOM_M, high - SMALLEST_ROOM_M)
    door = random.uniform(begin + 0.3, end - 0.3 - DOOR_M)
    for first, last in ((begin, door), (door + DOOR_M, end)):
        walls.append((at, first, at, last) if along_x else (first, at, last, at))
    _divide((x1, y1, at, y2) if along_x else (x1, y1, x2, at), walls, random)
    _divide((at, y1, x2, y2) if along_x else (x1, at, x2, y2), walls, random)


def _start(arena: Arena, boxes: list[list[float]], random: np.random.Generator) -> Pose:
    while True:
        x, y = random.random(2) * [arena.width_m, arena.height_m]
        inside = any(box[0] < x < box[2] and box[1] < y < box[3] for box in boxes)
        inside |= bool((np.hypot(*(arena.circles[:, :2] - (x, y)).T) < arena.circles[:, 2]).any())
        if not inside and arena.clearance_m(np.array([x, y])) > 0.5:
            return Pose(x, y, random.uniform(-np.pi, np.pi))


def drawn_map(arena: Arena, resolution_m: float = 0.05) -> tuple[NDArray[np.int8], Array]:
    """Return the map that a perfect mapper would make of an arena from its start.

    Returns:
        Occupancy `(H, W) int8` (0 free, 100 occupied, -1 never seen), row 0 at the smallest y; and the corner
        of cell (0, 0), m, arena frame.
    """
    corner = np.full(2, -0.25)
    shape = np.ceil((np.array([arena.height_m, arena.width_m]) + 0.5) / resolution_m).astype(int)
    rows, columns = np.indices((int(shape[0]), int(shape[1])))
    middles = (np.stack([columns, rows], axis=-1) + 0.5) * resolution_m + corner
    occupied = np.stack([arena.clearance_m(row) for row in middles]) < 0.75 * resolution_m
    regions, _ = ndimage.label(~occupied)
    column, row = ((np.array(arena.start[:2]) - corner) / resolution_m).astype(int)
    cells = np.where(regions == regions[row, column], 0, -1).astype(np.int8)
    cells[occupied] = 100
    return cells, corner
