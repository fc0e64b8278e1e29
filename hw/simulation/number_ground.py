"""Writes a random ground with numbered boards as YAML.

python -m robbie_robots.hw.simulation.number_ground --seed 3
"""

import argparse
import math
import string
import sys
from collections.abc import Sequence

import numpy as np

from robbie_robots.hw.simulation.arena_contents import BoardFont, Figure

COLUMNS, ROWS = 15, 12
BARRIER_M = 0.8
BOARD_HEIGHT_M = 0.58
EDGES_M = (0.3, 0.45, 0.6)
DISTRACTORS, OBSTACLES = 4, 3
# Nobody could tell these from a 0 or a 1.
LETTERS = [letter for letter in string.ascii_uppercase if letter not in "IO"]
APART_M, FROM_BARRIER_M, FROM_START_M = 1.7, 0.9, 2.2
FRONT_FREE_M, FRONTS_M = 0.6, (0.8, 1.3, 1.8)
"""At these distances in front of a board, nothing is nearer than the first."""
SHEET_AT_M, SHEET_HEIGHT_M = 1.5, 0.42
MAX_TRIES = 20_000

Place = tuple[float, float]


class BoardsDoNotFit(ValueError):
    """A ground has no room for all boards."""


def generate_ground(seed: int, *, sheet: bool = False) -> str:
    """Return a random ground as the text of an arena file.

    It has the digits 0 to 9 in any order, four boards with letters or figures, and three obstacles. The stock
    robot can stand in front of each board.

    Args:
        seed: random seed; the same seed gives the same text.
        sheet: whether a sheet at the start shows the order, which is random.

    Raises:
        CannotBeArranged: the boards found no places; choose another seed.
    """
    random = np.random.default_rng(seed)
    made = _Ground(random)
    option = " --sheet" if sheet else ""
    lines = [
        f"# A random ground: python -m robbie_robots.hw.simulation.number_ground --seed {seed}{option}",
        "cell_m: 1",
        f"wall_height_m: {BARRIER_M:g}",
        f"start_heading_rad: {made.heading_rad:.4f}",
        "drawing: |",
        *("  " + "".join(row) for row in made.drawing()),
        "circles:",
        *(f"  - [{x:.3f}, {y:.3f}, {radius:.3f}]" for x, y, radius in made.obstacles),
        "numbers:",
        *(f"  - {{{board}}}" for board in made.boards()),
    ]
    if sheet:
        order = "".join(str(digit) for digit in random.permutation(10))
        x, y = made.start
        x, y = x + SHEET_AT_M * math.cos(made.heading_rad), y + SHEET_AT_M * math.sin(made.heading_rad)
        place = f"x_m: {x:.3f}, y_m: {y:.3f}, height_m: {SHEET_HEIGHT_M:g}"
        lines.append(f'sheet: {{text: "{order}", {place}, facing_rad: {made.heading_rad + math.pi:.4f}}}')
    return "\n".join(lines) + "\n"


class _Ground:
    """Chooses start, obstacles and boards one after another."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random
        row, column = int(random.integers(4, ROWS - 4)), int(random.integers(5, COLUMNS - 5))
        self.start = (column + 0.5, row + 0.5)
        self._start_cell = (row, column)
        self.heading_rad = float(random.uniform(-math.pi, math.pi))
        self.obstacles: list[tuple[float, float, float]] = []
        self._places: list[tuple[float, float, float]] = []
        self._tries = 0
        for _ in range(OBSTACLES):
            self._add_obstacle()
        for _ in range(10 + DISTRACTORS):
            self._add_place()

    def drawing(self) -> list[list[str]]:
        """Return the barrier and the start, the upper row first."""
        cells = [["#"] * COLUMNS, *([*"#", *"." * (COLUMNS - 2), *"#"] for _ in range(ROWS - 2))]
        cells.append(["#"] * COLUMNS)
        row, column = self._start_cell
        cells[ROWS - 1 - row][column] = "R"
        return cells

    def boards(self) -> list[str]:
        """Return the boards as entries of the file: the digits, then the others."""
        random = self._random
        others = [str(text) for text in random.choice([*LETTERS, *map(str, Figure)], DISTRACTORS, False)]
        entries = []
        for text, (x, y, facing_rad) in zip([*string.digits, *others], self._places, strict=True):
            shadow = float(random.choice([0.0, random.uniform(0.2, 0.8)]))
            entries.append(
                f'text: "{text}", x_m: {x:.3f}, y_m: {y:.3f}, facing_rad: {facing_rad:.4f}, '
                f"height_m: {BOARD_HEIGHT_M:g}, edge_m: {random.choice(EDGES_M):g}, "
                f"font: {random.choice(list(BoardFont))}, light: {random.uniform(0.5, 1.0):.2f}, "
                f"shadow: {shadow:.2f}"
            )
        return entries

    def _add_obstacle(self) -> None:
        radius = float(self._random.uniform(0.15, 0.4))
        x, y = self._place(radius)
        self.obstacles.append((x, y, radius))

    def _add_place(self) -> None:
        """Add a place for a board with free space in front of it, which later boards keep free."""
        while True:
            x, y = self._place(0.0)
            for _ in range(12):
                facing_rad = float(self._random.uniform(-math.pi, math.pi))
                if all(self._is_free(front) for front in _fronts(x, y, facing_rad)):
                    self._places.append((x, y, facing_rad))
                    return

    def _place(self, radius: float) -> Place:
        """Return a place apart from the barrier, the start, and everything so far."""
        while self._tries < MAX_TRIES:
            self._tries += 1
            x = float(self._random.uniform(1 + FROM_BARRIER_M, COLUMNS - 1 - FROM_BARRIER_M))
            y = float(self._random.uniform(1 + FROM_BARRIER_M, ROWS - 1 - FROM_BARRIER_M))
            apart = [math.dist((x, y), other[:2]) - radius for other in self._places]
            apart += [math.dist((x, y), other[:2]) - radius - other[2] for other in self.obstacles]
            in_front = [
                math.dist((x, y), front) - radius for other in self._places for front in _fronts(*other)
            ]
            is_apart = min(apart, default=math.inf) >= APART_M
            if (
                is_apart
                and min(in_front, default=math.inf) >= FRONT_FREE_M
                and math.dist((x, y), self.start) >= FROM_START_M + radius
            ):
                return x, y
        raise BoardsDoNotFit(f"found no places for all boards in {MAX_TRIES} tries: choose another seed")

    def _is_free(self, place: Place) -> bool:
        """Return whether nothing is near to a place in front of a board."""
        x, y = place
        inside = (
            1 + FRONT_FREE_M <= x <= COLUMNS - 1 - FRONT_FREE_M
            and 1 + FRONT_FREE_M <= y <= ROWS - 1 - FRONT_FREE_M
        )
        others = [math.dist(place, other[:2]) for other in self._places]
        others += [math.dist(place, other[:2]) - other[2] for other in self.obstacles]
        return inside and min(others, default=math.inf) >= FRONT_FREE_M


def _fronts(x_m: float, y_m: float, facing_rad: float) -> list[Place]:
    """Return the places in front of a board that must be free."""
    return [(x_m + away * math.cos(facing_rad), y_m + away * math.sin(facing_rad)) for away in FRONTS_M]


def main(words: Sequence[str] | None = None) -> int:
    """Write a ground to standard output. `words` are the arguments of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m robbie_robots.hw.simulation.number_ground",
        description="Write a random ground with numbered boards as YAML to standard output.",
    )
    parser.add_argument("--seed", type=int, required=True, help="the same seed makes the same ground")
    parser.add_argument("--sheet", action="store_true", help="a sheet at the start shows the order")
    options = parser.parse_args(words)
    try:
        sys.stdout.write(generate_ground(options.seed, sheet=options.sheet))
    except BoardsDoNotFit as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
