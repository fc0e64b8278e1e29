"""Arenas drawn with characters: extracts walls and obstacles from a drawing."""

import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

WALL, OBSTACLE, START, FREE = "#", "o", "R", ". "


class DrawingError(ValueError):
    """An invalid drawing; `row` is the line, counted from 0 at the top."""

    def __init__(self, row: int, what: str) -> None:
        super().__init__(what)
        self.row = row


class ArenaDrawing:
    """A checked drawing: `#` wall, `.` or space free, `o` round obstacle, `R` the robot's start.

    Raises:
        DrawingError: an unknown character, lines of unequal length, not exactly one start, or an open border.
    """

    def __init__(self, lines: list[str]) -> None:
        if not lines:
            raise DrawingError(0, "the drawing is empty")
        for row, line in enumerate(lines):
            self._check_line(row, line, len(lines[0]))
        # Upside down, so that row 0 lies at y = 0.
        self._cells = np.array([list(line) for line in lines])[::-1]
        self.rows, self.columns = self._cells.shape
        self._start = self._find_start()
        self._check_closed()

    def start_m(self, cell_m: float) -> tuple[float, float]:
        """Return x and y of the middle of the start cell, m."""
        row, column = self._start
        return (column + 0.5) * cell_m, (row + 0.5) * cell_m

    def is_wall(self, x_m: float, y_m: float, cell_m: float) -> bool:
        """Return whether a point lies within a wall, or outside the drawing."""
        row, column = math.floor(y_m / cell_m), math.floor(x_m / cell_m)
        inside = 0 <= row < self.rows and 0 <= column < self.columns
        return not inside or bool(self._cells[row, column] == WALL)

    def round_obstacles(self, cell_m: float) -> NDArray[np.float64]:
        """Return x, y, radius of every round obstacle: (M, 3), m."""
        rows, columns = np.nonzero(self._cells == OBSTACLE)
        return np.stack([columns + 0.5, rows + 0.5, np.full(len(rows), 0.5)], axis=1) * cell_m

    def wall_segments(self, cell_m: float) -> NDArray[np.float64]:
        """Return the outlines of the walls, each straight piece as one segment: (N, 4), m."""
        walls = np.pad(self._cells == WALL, 1).astype(np.int8)
        # An edge of the outline lies where a wall cell and another cell are neighbours.
        horizontal = np.diff(walls, axis=0)[:, 1:-1]
        vertical = np.diff(walls, axis=1)[1:-1, :].T
        pieces = [(begin, y, end, y) for y, begin, end in _runs(horizontal)]
        pieces += [(x, begin, x, end) for x, begin, end in _runs(vertical)]
        return np.array(pieces, dtype=np.float64).reshape(-1, 4) * cell_m

    @staticmethod
    def _check_line(row: int, line: str, width: int) -> None:
        for column, character in enumerate(line):
            if character not in WALL + OBSTACLE + START + FREE:
                raise DrawingError(
                    row,
                    f"unknown character {character!r} in column {column + 1} of the drawing; "
                    "use # for a wall, . for free, o for a round obstacle, R for the robot's start",
                )
        if len(line) != width:
            raise DrawingError(row, f"this line has {len(line)} characters, the first line has {width}")

    def _find_start(self) -> tuple[int, int]:
        rows, columns = np.nonzero(self._cells == START)
        if len(rows) == 0:
            raise DrawingError(0, "the drawing has no R: mark where the robot starts")
        if len(rows) > 1:
            raise DrawingError(
                self.rows - 1 - int(rows[0]), "the drawing has a second R: a robot has only one start"
            )
        return int(rows[0]), int(columns[0])

    def _check_closed(self) -> None:
        regions, _ = ndimage.label(self._cells != WALL)
        inside = regions == regions[self._start]
        border = np.ones_like(inside)
        border[1:-1, 1:-1] = False
        rows, columns = np.nonzero(inside & border)
        if len(rows):
            raise DrawingError(
                self.rows - 1 - int(rows[0]),
                f"the arena is not closed: the robot can leave it at column {columns[0] + 1} of the drawing",
            )


def _runs(edges: NDArray[np.int8]) -> list[tuple[int, int, int]]:
    """Return (line, begin, end) of each run of equal edges that are not 0."""
    runs = []
    for line, values in enumerate(edges):
        bounds = np.flatnonzero(np.diff(np.concatenate([[0], values, [0]])))
        runs += [(line, int(a), int(b)) for a, b in itertools.pairwise(bounds) if values[a]]
    return runs
