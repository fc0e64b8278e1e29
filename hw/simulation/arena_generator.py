"""Random arenas: rooms along a corridor, obstacles in them, victims and signs on the walls."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from robbie_robots.hw.simulation.arena_contents import SignKind, VictimKind, WallSpot
from robbie_robots.hw.simulation.aruco import TAG_COUNT
from robbie_robots.hw.simulation.reachable_area import Mask, connected
from robbie_robots.hw.simulation.room_plan import RoomPlan

# Edge of a cell of the drawing, and the number of finer cells along that edge.
CELL_M, FINE = 0.25, 5
FINE_M = CELL_M / FINE
# A robot that keeps either distance from obstacles reaches every place; the stock robot's radius is 0.2 m.
PASS_M = (0.25, 0.35)
# Victims and signs can be viewed from this distance, with nothing in between.
VIEW_M = 0.8
# Minimum distance in the plane between victims and signs, so that each can be told from the others.
MIN_APART_M = 1.0
# Minimum distance of everything from the start.
START_FREE_M = 1.2
TRIES = 4

Rectangle = tuple[float, float, float, float]
Circle = tuple[float, float, float]


class CannotBeArranged(ValueError):
    """The arena is too small for its contents."""


@dataclass(frozen=True)
class ArenaWishes:
    """The contents wanted in a random arena.

    Attributes:
        width_m: extent in x, with the outer walls.
        height_m: extent in y, with the outer walls.
        victims: number of victims on the walls; every other one waves.
        signs: number of signs on the walls.
        obstacles: maximum number of circles and boxes; those that would cut off a place are omitted.
        appearing: number of circles that appear in the first minutes for half a minute.
    """

    width_m: float = 10.0
    height_m: float = 8.0
    victims: int = 4
    signs: int = 2
    obstacles: int = 8
    appearing: int = 0


class ArenaGenerator:
    """Generates one arena.

    Args:
        seed: the same seed and wishes make the same arena.
        wishes: the wanted contents.

    Attributes:
        walls: (rows, columns), True at walls; row 0 lies at y = 0.
        start: row and column of the robot's start cell.
        start_heading_rad: the robot's heading at the start.
        boxes: x1, y1, x2, y2 of each, m.
        circles: x, y, radius of each, m.
        victims: tag, kind and place of each.
        signs: kind and place of each.
        appearing: circle, and when it appears, s.

    Raises:
        CannotBeArranged: the walls have no room for all victims and signs, or the arena is too small.
    """

    def __init__(self, seed: int, wishes: ArenaWishes | None = None) -> None:
        wishes = wishes or ArenaWishes()
        self._random = np.random.default_rng(seed)
        rows, columns = round(wishes.height_m / CELL_M), round(wishes.width_m / CELL_M)
        if min(rows, columns) < 10 or not 0 <= wishes.victims <= TAG_COUNT:
            raise CannotBeArranged(
                f"an arena must be at least 2.5 m wide and may have at most {TAG_COUNT} victims"
            )
        self.walls = RoomPlan(rows, columns, self._random).draw()
        self._solid = self.walls.repeat(FINE, axis=0).repeat(FINE, axis=1)
        self.start = self._choose_start()
        self.start_heading_rad = int(self._random.integers(4)) * math.pi / 2
        self.boxes: list[Rectangle] = []
        self.circles: list[Circle] = []
        for _ in range(wishes.obstacles):
            self._add_obstacle()
        spots = self._choose_spots(wishes.victims + wishes.signs)
        tags = self._random.permutation(TAG_COUNT).tolist()
        kinds = (VictimKind.STILL, VictimKind.MOVING)
        self.victims = [
            (tags[number], kinds[number % 2], spot) for number, spot in enumerate(spots[: wishes.victims])
        ]
        self.signs = [(self._random.choice(list(SignKind)), spot) for spot in spots[wishes.victims :]]
        self.appearing = [self._choose_appearing() for _ in range(wishes.appearing)]

    def _choose_start(self) -> tuple[int, int]:
        """Return a cell with free cells all around, preferably near a corner of the arena."""
        roomy = np.argwhere(ndimage.distance_transform_cdt(~self.walls, "chessboard") >= 3)
        some = self._random.permutation(roomy)[:TRIES]
        middle = np.array(self.walls.shape) / 2
        row, column = max(some, key=lambda cell: float(np.hypot(*(cell - middle))))
        return int(row), int(column)

    def _reached(self, solid: Mask, apart_m: float = PASS_M[-1]) -> tuple[Mask, Mask]:
        """Return the cells at least that far from everything solid, and the reachable ones of them."""
        roomy = np.asarray(ndimage.distance_transform_edt(~solid) * FINE_M > apart_m)
        start = self.start[0] * FINE + FINE // 2, self.start[1] * FINE + FINE // 2
        return roomy, connected(roomy, start)

    def _is_connected(self, solid: Mask) -> bool:
        """Return whether every place that is wide enough can be reached."""
        both = (self._reached(solid, apart_m) for apart_m in PASS_M)
        return all(reached.sum() >= 0.999 * roomy.sum() for roomy, reached in both)

    def _from_start_m(self, x_m: float, y_m: float) -> float:
        return math.hypot(x_m - (self.start[1] + 0.5) * CELL_M, y_m - (self.start[0] + 0.5) * CELL_M)

    def _add_obstacle(self) -> None:
        """Add a box or circle if one of several tries finds a place where it cuts nothing off."""
        for _ in range(TRIES):
            x, y = self._place(~self._solid)
            if self._random.random() < 0.5:
                circle = (x, y, round(float(self._random.uniform(0.08, 0.3)), 2))
                if self._block(self._covered(circle), self._from_start_m(x, y) - circle[2]):
                    self.circles.append(circle)
                    return
            else:
                half_x, half_y = (round(float(half), 2) for half in self._random.uniform(0.1, 0.4, 2))
                box = (
                    round(x - half_x, 3),
                    round(y - half_y, 3),
                    round(x + half_x, 3),
                    round(y + half_y, 3),
                )
                if self._block(self._covered(box), self._from_start_m(x, y) - math.hypot(half_x, half_y)):
                    self.boxes.append(box)
                    return

    def _block(self, covered: Mask, from_start_m: float) -> bool:
        """Make cells solid unless they are too near the start or cut something off. Return whether it did."""
        solid = self._solid | covered
        if from_start_m <= START_FREE_M / 2 or not self._is_connected(solid):
            return False
        self._solid = solid
        return True

    def _covered(self, shape: tuple[float, ...]) -> Mask:
        rows, columns = self._solid.shape
        y, x = (np.mgrid[:rows, :columns] + 0.5) * FINE_M
        if len(shape) == 3:
            return np.asarray(np.hypot(x - shape[0], y - shape[1]) <= shape[2] + FINE_M / 2)
        x1, y1, x2, y2 = shape
        reach = FINE_M / 2
        return np.asarray((x >= x1 - reach) & (x <= x2 + reach) & (y >= y1 - reach) & (y <= y2 + reach))

    def _place(self, where: Mask) -> tuple[float, float]:
        """Return x and y of a random cell of the mask, m."""
        cells = np.argwhere(where)
        row, column = cells[self._random.integers(len(cells))]
        return round((column + 0.5) * FINE_M, 3), round((row + 0.5) * FINE_M, 3)

    def _choose_spots(self, count: int) -> list[WallSpot]:
        """Return visible places on walls. Each is the best of several: the farthest from the others."""
        candidates = [
            spot for spot in self._wall_middles() if self._from_start_m(spot.x_m, spot.y_m) > START_FREE_M
        ]
        _, reached = self._reached(self._solid)
        candidates = [spot for spot in candidates if self._can_be_looked_at(spot, reached)]
        chosen: list[WallSpot] = []
        while len(chosen) < count:
            candidates = [
                spot
                for spot in candidates
                if all(
                    math.dist((spot.x_m, spot.y_m), (other.x_m, other.y_m)) > MIN_APART_M for other in chosen
                )
            ]
            if not candidates:
                raise CannotBeArranged(f"the walls have no room for {count} victims and signs")
            some = [candidates[n] for n in self._random.integers(len(candidates), size=TRIES)]
            chosen.append(max(some, key=lambda spot: _nearest_m(spot, chosen)))
        order = self._random.permutation(len(chosen))
        return [chosen[number] for number in order]

    def _wall_middles(self) -> list[WallSpot]:
        """Return the middles of wall cells' sides whose two neighbours in the same wall are free as well."""
        spots = []
        for facing_rad, (down, right) in zip(
            (0.0, math.pi / 2, math.pi, -math.pi / 2), ((0, 1), (1, 0), (0, -1), (-1, 0)), strict=True
        ):
            front = np.roll(self.walls, (-down, -right), (0, 1))
            side = self.walls & ~front
            straight = side & np.roll(side, (right, down), (0, 1)) & np.roll(side, (-right, -down), (0, 1))
            for row, column in np.argwhere(straight).tolist():
                x, y = (column + 0.5 + right / 2) * CELL_M, (row + 0.5 + down / 2) * CELL_M
                if 0 < x < self.walls.shape[1] * CELL_M and 0 < y < self.walls.shape[0] * CELL_M:
                    spots.append(WallSpot(round(x, 3), round(y, 3), 0.35, round(facing_rad, 4)))
        return spots

    def _can_be_looked_at(self, spot: WallSpot, reached: Mask) -> bool:
        cos, sin = math.cos(spot.facing_rad), math.sin(spot.facing_rad)
        ahead, aside = np.mgrid[FINE_M / 2 : VIEW_M : FINE_M, -CELL_M : CELL_M * 1.01 : FINE_M]
        columns = ((spot.x_m + ahead * cos - aside * sin) / FINE_M).astype(np.intp)
        rows = ((spot.y_m + ahead * sin + aside * cos) / FINE_M).astype(np.intp)
        if (
            rows.min() < 0
            or columns.min() < 0
            or rows.max() >= reached.shape[0]
            or columns.max() >= reached.shape[1]
        ):
            return False
        middle = aside.shape[1] // 2
        return bool(reached[rows[-1, middle], columns[-1, middle]]) and not self._solid[rows, columns].any()

    def _choose_appearing(self) -> tuple[Circle, float]:
        """Return a circle away from the start, and when it appears, s."""
        rows, columns = self._solid.shape
        y, x = (np.mgrid[:rows, :columns] + 0.5) * FINE_M
        start_y, start_x = (cell * CELL_M for cell in self.start)
        away = np.hypot(x - start_x, y - start_y) > START_FREE_M
        place = self._place(self._reached(self._solid)[1] & away)
        radius, begin_s = self._random.uniform(0.12, 0.25), self._random.uniform(15.0, 90.0)
        return (*place, round(float(radius), 2)), round(float(begin_s))


def _nearest_m(spot: WallSpot, others: list[WallSpot]) -> float:
    return min(
        (math.dist((spot.x_m, spot.y_m), (other.x_m, other.y_m)) for other in others), default=math.inf
    )
