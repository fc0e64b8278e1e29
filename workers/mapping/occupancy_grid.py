"""Occupancy grid: how likely it is that each cell of the plane holds an obstacle.

After Elfes, "Using occupancy grids for mobile robot perception and navigation" (IEEE Computer, 1989), and
Moravec and Elfes (ICRA 1985): the evidence of each sweep adds to the log-odds of a cell. The grid stores two
counts (beams that ended in a cell, sweeps that looked through it) and computes the log-odds from them. So it
can remove a sweep exactly when its pose is corrected.

The plane is divided into square tiles. Only tiles in which something was seen take memory, so the grid has no
extent of its own, and a long corridor costs as much as a room of the same area.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

LOG_ODDS_HIT = 0.85  # a beam ended here: occupied with p = 0.70
LOG_ODDS_PASS = -0.4  # a sweep looked through: occupied with p = 0.40
TILE = 32  # cells along a tile's edge
TILE_CELLS = TILE * TILE
BLOCK = 512  # tiles allocated together
HIT, PASSED = 0, 1
FAR = 1 << 30  # tile coordinates are packed into one integer; no robot drives that far


class GridFull(MemoryError):
    """The area that was seen exceeds the grid's limit."""


@dataclass(frozen=True)
class Window:
    """A rectangle of cells: from `low` (x, y) up to, but not including, `high`, in cells from the origin."""

    low: NDArray[np.int64]
    high: NDArray[np.int64]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        width, height = (self.high - self.low).tolist()
        return height, width

    def around(self, centre: ArrayLike, most_cells: int) -> "Window":
        """Return the largest part, as square as possible, around a cell that has at most so many cells."""
        height, width = self.shape
        if height * width <= most_cells:
            return self
        side = int(np.sqrt(most_cells))
        wide = width if width < side else min(width, most_cells // min(height, side))
        size = np.array([wide, min(height, most_cells // wide)])
        low = np.clip(np.asarray(centre, np.int64) - size // 2, self.low, self.high - size)
        return Window(low, low + size)

    def bands(self, rows: int) -> "Iterator[Window]":
        """Cut the window into bands of at most `rows` rows, beginning with the largest y."""
        for top in range(int(self.high[1]), int(self.low[1]), -rows):
            low = max(top - rows, int(self.low[1]))
            yield Window(np.array([self.low[0], low]), np.array([self.high[0], top]))


class OccupancyGrid:
    """A grid without a fixed extent, whose memory grows with the area that was seen.

    Args:
        resolution_m: Edge of a cell.
        max_cells: Maximum number of cells in tiles in which something was seen (5 bytes each).
    """

    def __init__(self, resolution_m: float = 0.05, max_cells: int = 60_000_000) -> None:
        self.resolution_m = resolution_m
        self.max_cells = max_cells
        self._slots: dict[int, int] = {}  # packed tile coordinates: the tile's number
        self._free: list[int] = []
        self._changed: set[int] = set()  # packed coordinates of tiles whose occupancy is out of date
        self._counts: list[NDArray[Any]] = []  # by block: (2, BLOCK * TILE_CELLS), unsigned
        self._percent: list[NDArray[np.int8]] = []  # by block: (BLOCK, TILE, TILE)

    def add(self, origin_xy_m: ArrayLike, points: ArrayLike) -> None:
        """Add a sweep: `points` `(N, 2)`, m, map frame, were hit by beams from `origin_xy_m`.

        Raises:
            GridFull: The sweep would make the grid exceed its limit of cells. The grid does not change.
        """
        hits, passed = self._drawn(origin_xy_m, points)
        self._cover(np.unique(np.concatenate([_tiles(hits.cells), _tiles(passed.cells)])))
        self._count(HIT, hits, 1)
        self._count(PASSED, passed, 1)

    def remove(self, origin_xy_m: ArrayLike, points: ArrayLike) -> None:
        """Remove a sweep that was added with exactly these values."""
        hits, passed = self._drawn(origin_xy_m, points)
        self._count(HIT, hits, -1)
        self._count(PASSED, passed, -1)

    @property
    def bytes(self) -> int:
        """Memory of the grid's cells."""
        return sum(block.nbytes for block in (*self._counts, *self._percent))

    def known(self) -> Window:
        """Return the smallest window of whole tiles that contains all that was seen."""
        self._refresh()
        if not self._slots:
            return Window(np.zeros(2, np.int64), np.zeros(2, np.int64))
        tiles = _unpacked(np.fromiter(self._slots, np.int64, len(self._slots)))
        return Window(tiles.min(axis=0) * TILE, (tiles.max(axis=0) + 1) * TILE)

    def cells(self, window: Window | None = None) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
        """Return the map in ROS's form, and its position.

        Args:
            window: The part to return; all that is known without it.

        Returns:
            Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 where nothing was seen; and the
            position (x, y) of the outer corner of cell (0, 0), m, map frame.
        """
        known = self.known()
        window = window or known
        percent: NDArray[np.int8] = np.full(window.shape, -1, dtype=np.int8)
        for left, bottom, tile in self._inside(window):
            column, row = left - int(window.low[0]), bottom - int(window.low[1])
            rows = slice(max(row, 0), min(row + TILE, percent.shape[0]))
            columns = slice(max(column, 0), min(column + TILE, percent.shape[1]))
            percent[rows, columns] = tile[
                rows.start - row : rows.stop - row, columns.start - column : columns.stop - column
            ]
        corner_m: NDArray[np.float64] = window.low * np.float64(self.resolution_m)
        return percent, corner_m

    def overview(self, most_cells: int) -> tuple[NDArray[np.int8], NDArray[np.float64], float]:
        """Return all that is known, with coarser cells if there are more than `most_cells`.

        Returns:
            Occupancy, the greatest of each coarse cell, and its position, as `cells` does; and the edge of a
            coarse cell, m.
        """
        known = self.known()
        height, width = known.shape
        coarse = 1
        while coarse < TILE and height * width > most_cells * coarse**2:
            coarse *= 2
        percent: NDArray[np.int8] = np.full((height // coarse, width // coarse), -1, dtype=np.int8)
        side = TILE // coarse
        for left, bottom, tile in self._inside(known):
            column, row = (left - int(known.low[0])) // coarse, (bottom - int(known.low[1])) // coarse
            percent[row : row + side, column : column + side] = tile.reshape(side, coarse, side, coarse).max(
                axis=(1, 3)
            )
        corner_m: NDArray[np.float64] = known.low * np.float64(self.resolution_m)
        return percent, corner_m, self.resolution_m * coarse

    def _inside(self, window: Window) -> Iterator[tuple[int, int, NDArray[np.int8]]]:
        """Yield the tiles that touch a window: their left and lowest cell, and their occupancy."""
        keys = np.fromiter(self._slots, np.int64, len(self._slots))
        low = _unpacked(keys) * TILE
        inside = ((low < window.high) & (low + TILE > window.low)).all(axis=1)
        for key, (left, bottom) in zip(keys[inside].tolist(), low[inside].tolist(), strict=True):
            slot = self._slots[key]
            yield left, bottom, self._percent[slot // BLOCK][slot % BLOCK]

    def _drawn(self, origin_xy_m: ArrayLike, points: ArrayLike) -> "tuple[_Counts, _Counts]":
        """Draw one sweep: the cells it hit, and those it looked through but did not hit."""
        origin, ends = np.asarray(origin_xy_m, float), np.asarray(points, float).reshape(-1, 2)
        beams = ends - origin
        length = np.hypot(beams[:, 0], beams[:, 1])
        steps = np.floor(length / self.resolution_m).astype(np.int64)
        beam = np.repeat(np.arange(len(ends)), steps)
        step = np.arange(len(beam)) - np.repeat(np.cumsum(steps) - steps, steps)
        along = origin + beams[beam] * (step * self.resolution_m / length[beam])[:, None]
        hit, passed = (np.floor(places / self.resolution_m).astype(np.int64) for places in (ends, along))
        every = np.concatenate([hit, passed, np.floor(origin / self.resolution_m).astype(np.int64)[None]])
        corner = every.min(axis=0)
        shape = tuple((every.max(axis=0) - corner + 1)[::-1])
        hits, passes = np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=bool)
        passes[passed[:, 1] - corner[1], passed[:, 0] - corner[0]] = True
        np.add.at(hits, (hit[:, 1] - corner[1], hit[:, 0] - corner[0]), 1)
        passes &= hits == 0
        hit_at, passed_at = np.nonzero(hits), np.nonzero(passes)
        return (
            _Counts(np.column_stack(hit_at[::-1]) + corner, hits[hit_at]),
            _Counts(np.column_stack(passed_at[::-1]) + corner, np.ones(len(passed_at[0]), np.int32)),
        )

    def _cover(self, tiles: NDArray[np.int64]) -> None:
        """Take memory for tiles that have none."""
        new = [tile for tile in tiles.tolist() if tile not in self._slots]
        if not new:
            return
        if (len(self._slots) + len(new)) * TILE_CELLS > self.max_cells:
            self._refresh()  # frees the tiles that sweeps have left
            new = [tile for tile in tiles.tolist() if tile not in self._slots]
        if (len(self._slots) + len(new)) * TILE_CELLS > self.max_cells:
            raise GridFull(
                f"the area seen at {self.resolution_m} m is more than {self.max_cells} cells; "
                "choose a coarser resolution or allow more cells"
            )
        for tile in new:
            if not self._free:
                first = len(self._counts) * BLOCK
                self._counts.append(np.zeros((2, BLOCK * TILE_CELLS), np.uint16))
                self._percent.append(np.full((BLOCK, TILE, TILE), -1, np.int8))
                self._free.extend(range(first + BLOCK - 1, first - 1, -1))
            self._slots[tile] = self._free.pop()

    def _count(self, which: int, counts: "_Counts", by: int) -> None:
        tiles = _tiles(counts.cells)
        each, member = np.unique(tiles, return_inverse=True)
        keys = each.tolist()
        self._changed.update(keys)
        slots = np.array([self._slots[key] for key in keys], np.int64)[member]
        inside = counts.cells % TILE
        place = slots % BLOCK * TILE_CELLS + inside[:, 1] * TILE + inside[:, 0]
        blocks = slots // BLOCK
        for block in np.unique(blocks).tolist():
            here = blocks == block
            at = place[here]
            new = self._counts[block][which, at].astype(np.int64) + by * counts.number[here]
            if new.max() > np.iinfo(self._counts[block].dtype).max:
                self._counts[block] = self._counts[block].astype(np.uint32)
            self._counts[block][which, at] = new

    def _refresh(self) -> None:
        """Compute the occupancy of changed tiles, and free those in which nothing is seen any more."""
        for key in sorted(self._changed):
            slot = self._slots[key]
            block, number = divmod(slot, BLOCK)
            part = slice(number * TILE_CELLS, (number + 1) * TILE_CELLS)
            hits, passes = self._counts[block][:, part].astype(np.float64)
            percent = np.round(100 / (1 + np.exp(-(LOG_ODDS_HIT * hits + LOG_ODDS_PASS * passes))))
            percent[(hits == 0) & (passes == 0)] = -1
            self._percent[block][number] = percent.reshape(TILE, TILE)
            if (percent < 0).all():
                del self._slots[key]
                self._free.append(slot)
        self._changed.clear()


@dataclass(frozen=True)
class _Counts:
    """What to count: cells `(N, 2)` (x, y), each once, and the number for each."""

    cells: NDArray[np.int64]
    number: NDArray[np.int32]


def _tiles(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the packed coordinates of the tile of each cell."""
    tiles = cells // TILE + FAR
    packed: NDArray[np.int64] = (tiles[:, 1] << 32) | tiles[:, 0]
    return packed


def _unpacked(tiles: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.column_stack([tiles & 0xFFFFFFFF, tiles >> 32]) - FAR
