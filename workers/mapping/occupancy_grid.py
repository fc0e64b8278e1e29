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

LOG_ODDS_STEP = 0.05
HIT_STEPS = 17  # log-odds 0.85: a beam ended here, so occupied with p = 0.70
PASS_STEPS = -8  # log-odds -0.4: a sweep looked through, so occupied with p = 0.40
MOST_STEPS = 140  # from here on, the percentage is 0 or 100
STEPS = np.arange(-MOST_STEPS, MOST_STEPS + 1)
PERCENT = np.round(100 / (1 + np.exp(-LOG_ODDS_STEP * STEPS))).astype(np.int8)  # of each number of steps
TILE = 32  # cells along a tile's edge
TILE_CELLS = TILE * TILE
BLOCK = 512  # tiles allocated together
BATCH = 64  # tiles whose occupancy is computed at a time, so that the arrays stay in the cache
HIT, PASSED = 0, 1
FAR = 1 << 30  # tile coordinates are packed into one integer; no robot drives that far


class GridFull(MemoryError):
    """The area that was seen exceeds the grid's limit."""


@dataclass(frozen=True)
class CellWindow:
    """A rectangle of cells: from `low` (x, y) up to, but not including, `high`, in cells from the origin."""

    low: NDArray[np.int64]
    high: NDArray[np.int64]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        width, height = (self.high - self.low).tolist()
        return height, width

    def around(self, centre: ArrayLike, most_cells: int) -> "CellWindow":
        """Return the largest part around a cell with at most `most_cells` cells, as square as possible."""
        height, width = self.shape
        if height * width <= most_cells:
            return self
        side = int(np.sqrt(most_cells))
        wide = width if width < side else min(width, most_cells // min(height, side))
        size = np.array([wide, min(height, most_cells // wide)])
        low = np.clip(np.asarray(centre, np.int64) - size // 2, self.low, self.high - size)
        return CellWindow(low, low + size)

    def bands(self, rows: int) -> "Iterator[CellWindow]":
        """Cut the window into bands of at most `rows` rows, beginning with the largest y."""
        for top in range(int(self.high[1]), int(self.low[1]), -rows):
            low = max(top - rows, int(self.low[1]))
            yield CellWindow(np.array([self.low[0], low]), np.array([self.high[0], top]))


class GrowingGrid:
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
        self._counts: list[NDArray[Any]] = []  # by block: (2, BLOCK, TILE, TILE), unsigned
        self._percent: list[NDArray[np.int8]] = []  # by block: (BLOCK, TILE, TILE)

    def add(self, origin_xy_m: ArrayLike, points: ArrayLike) -> None:
        """Add a sweep: `points` `(N, 2)`, m, map frame, were hit by beams from `origin_xy_m`.

        Raises:
            GridFull: The sweep would make the grid exceed its limit of cells. The grid does not change.
        """
        drawing = _Drawing.of(origin_xy_m, points, self.resolution_m)
        self._cover(drawing.tiles)
        self._count(drawing, 1)

    def remove(self, origin_xy_m: ArrayLike, points: ArrayLike) -> None:
        """Remove a sweep that was added with exactly these values."""
        self._count(_Drawing.of(origin_xy_m, points, self.resolution_m), -1)

    @property
    def bytes(self) -> int:
        """Memory of the grid's cells."""
        return sum(block.nbytes for block in (*self._counts, *self._percent))

    def known(self) -> CellWindow:
        """Return the smallest window of whole tiles that contains all that was seen."""
        self._refresh()
        if not self._slots:
            return CellWindow(np.zeros(2, np.int64), np.zeros(2, np.int64))
        tiles = _unpacked(np.fromiter(self._slots, np.int64, len(self._slots)))
        return CellWindow(tiles.min(axis=0) * TILE, (tiles.max(axis=0) + 1) * TILE)

    def cells(self, window: CellWindow | None = None) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
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

    def _inside(self, window: CellWindow) -> Iterator[tuple[int, int, NDArray[np.int8]]]:
        """Yield the tiles that touch a window: their left and lowest cell, and their occupancy."""
        keys = np.fromiter(self._slots, np.int64, len(self._slots))
        low = _unpacked(keys) * TILE
        inside = ((low < window.high) & (low + TILE > window.low)).all(axis=1)
        for key, (left, bottom) in zip(keys[inside].tolist(), low[inside].tolist(), strict=True):
            slot = self._slots[key]
            yield left, bottom, self._percent[slot // BLOCK][slot % BLOCK]

    def _cover(self, tiles: list[int]) -> None:
        """Take memory for tiles that have none."""
        new = [tile for tile in tiles if tile not in self._slots]
        if not new:
            return
        if (len(self._slots) + len(new)) * TILE_CELLS > self.max_cells:
            self._refresh()  # frees the tiles that sweeps have left
            new = [tile for tile in tiles if tile not in self._slots]
        if (len(self._slots) + len(new)) * TILE_CELLS > self.max_cells:
            raise GridFull(
                f"the area seen at {self.resolution_m} m is more than {self.max_cells} cells; "
                "choose a coarser resolution or allow more cells"
            )
        for tile in new:
            if not self._free:
                first = len(self._counts) * BLOCK
                self._counts.append(np.zeros((2, BLOCK, TILE, TILE), np.uint16))
                self._percent.append(np.full((BLOCK, TILE, TILE), -1, np.int8))
                self._free.extend(range(first + BLOCK - 1, first - 1, -1))
            self._slots[tile] = self._free.pop()

    def _count(self, drawing: "_Drawing", by: int) -> None:
        self._changed.update(drawing.tiles)
        slots = np.array([self._slots[tile] for tile in drawing.tiles], np.int64)
        for block, numbers, here in _by_block(slots):
            counts = self._counts[block]
            old = counts[:, numbers]
            new = drawing.counts[:, here]
            if by > 0 and int(old.max()) + int(new.max()) > np.iinfo(counts.dtype).max:
                counts = self._counts[block] = counts.astype(np.uint32)
                old = old.astype(np.uint32)
            counts[:, numbers] = old + new if by > 0 else old - new

    def _refresh(self) -> None:
        """Compute the occupancy of changed tiles, and free those in which nothing is seen any more."""
        keys = sorted(self._changed)
        slots = np.array([self._slots[key] for key in keys], np.int64)
        for block, numbers, here in _by_block(slots):
            for begin in range(0, len(numbers), BATCH):
                batch = numbers[begin : begin + BATCH]
                hits, passes = self._counts[block][:, batch].astype(np.int32)
                steps = np.clip(HIT_STEPS * hits + PASS_STEPS * passes, -MOST_STEPS, MOST_STEPS)
                percent = PERCENT[steps + MOST_STEPS]
                percent[(hits == 0) & (passes == 0)] = -1
                self._percent[block][batch] = percent
                for number in np.flatnonzero((percent < 0).all(axis=(1, 2))).tolist():
                    self._free.append(self._slots.pop(keys[here[begin + number]]))
        self._changed.clear()


@dataclass(frozen=True)
class _Drawing:
    """One sweep as the cells that it hit, and those that it looked through but did not hit.

    Attributes:
        tiles: Packed coordinates of the tiles in which there are any.
        counts: `(2, len(tiles), TILE, TILE)`: the number of hits of each cell, and of looks through it.
    """

    tiles: list[int]
    counts: NDArray[np.uint16]

    @staticmethod
    def of(origin_xy_m: ArrayLike, points: ArrayLike, resolution_m: float) -> "_Drawing":
        """Draw the beams from an origin to points, over the box of whole tiles around them."""
        # Coordinates lie in rows, `(2, N)`: numpy is several times faster along them.
        origin, ends = np.asarray(origin_xy_m, float)[:, None], np.asarray(points, float).reshape(-1, 2).T
        beams = ends - origin
        length = np.hypot(*beams)
        steps = np.floor(length / resolution_m).astype(np.int64)
        beam = np.repeat(np.arange(len(steps)), steps)
        step = np.arange(len(beam)) - np.repeat(np.cumsum(steps) - steps, steps)
        along = origin + beams.take(beam, axis=1) * (step * resolution_m / length[beam])
        hit, passed, start = (
            np.floor(places / resolution_m).astype(np.int64) for places in (ends, along, origin)
        )
        cells = np.concatenate([hit, passed, start], axis=1)
        low = cells.min(axis=1) // TILE
        width, height = (cells.max(axis=1) // TILE - low + 1).tolist()
        hit_at, passed_at = (_index(places - low[:, None] * TILE, width) for places in (hit, passed))
        counts = np.zeros((2, height * width * TILE_CELLS), np.uint16)
        counts[PASSED, passed_at] = 1
        counts[PASSED, hit_at] = 0
        np.add.at(counts[HIT], hit_at, 1)
        has_any = np.zeros(height * width, dtype=bool)
        has_any[hit_at // TILE_CELLS] = has_any[passed_at // TILE_CELLS] = True
        seen = np.flatnonzero(has_any)
        rows, columns = np.divmod(seen, width)
        packed = ((rows + low[1] + FAR) << 32) | (columns + low[0] + FAR)
        return _Drawing(packed.tolist(), counts.reshape(2, -1, TILE, TILE)[:, seen])


def _index(cells: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """Return where cells `(2, N)` (x, y) lie in an array of tiles, `width` tiles in a row."""
    tiles = cells // TILE
    inside = cells - TILE * tiles
    index: NDArray[np.int64] = (tiles[1] * width + tiles[0]) * TILE_CELLS + inside[1] * TILE + inside[0]
    return index


def _by_block(slots: NDArray[np.int64]) -> "Iterator[tuple[int, NDArray[np.int64], NDArray[np.int64]]]":
    """Group tiles by block: its number, the tiles' numbers in it, and their places in `slots`."""
    blocks = slots // BLOCK
    for block in np.unique(blocks).tolist():
        here = np.flatnonzero(blocks == block)
        yield block, slots[here] % BLOCK, here


def _unpacked(tiles: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.column_stack([tiles & 0xFFFFFFFF, tiles >> 32]) - FAR
