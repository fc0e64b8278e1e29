"""A bounded log of rows of numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FIRST_ROOM = 1024


class RowLog:
    """Rows of floats in order of arrival; at its limit the log drops the older half.

    Args:
        columns: Count of numbers in a row.
        most_rows: Maximum number of rows.
    """

    def __init__(self, columns: int, most_rows: int) -> None:
        self.most_rows = most_rows
        self.forgotten = 0
        self._rows = np.zeros((min(FIRST_ROOM, most_rows), columns))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray[np.float64]:
        """The stored rows, `(N, columns)`: a view that the next `add` may change."""
        return self._rows[: self._count]

    @property
    def end(self) -> int:
        """Number of the next row, counted from the first row ever added. Row `end - 1` is the last one."""
        return self.forgotten + self._count

    def state(self) -> dict[str, Any]:
        """Return the rows, and the number of dropped rows before them. The next `add` may change the rows."""
        return {"rows": self.rows, "forgotten": self.forgotten}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        self.forgotten = int(state["forgotten"])
        self._rows = np.array(state["rows"], float).reshape(-1, self._rows.shape[1])
        self._count = len(self._rows)

    def add(self, row: ArrayLike) -> None:
        """Append a row."""
        if self._count == self.most_rows:
            half = self._count // 2
            self._rows[: self._count - half] = self._rows[half:].copy()
            self.forgotten += half
            self._count -= half
        elif self._count == len(self._rows):
            room = min(max(self._count, FIRST_ROOM), self.most_rows - self._count)
            self._rows = np.concatenate([self._rows, np.zeros((room, self._rows.shape[1]))])
        self._rows[self._count] = row
        self._count += 1
