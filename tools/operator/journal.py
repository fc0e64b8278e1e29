"""Reads what the witness has written so far."""

from bisect import bisect_right
from pathlib import Path


class WitnessReader:
    """Reads a witness's file while it grows.

    Args:
        file: path of the file, which need not exist yet.
    """

    def __init__(self, file: Path):
        self._path = file
        self._offset = 0
        self._times: dict[str, list[int]] = {}
        self._numbers: dict[str, list[float]] = {}

    def newest(self, what: str) -> float:
        """Return the latest number of a kind, or 0 if there is none."""
        self._read()
        return self._numbers[what][-1] if what in self._numbers else 0.0

    def first_after(self, what: str, since_ns: int, number: float) -> int | None:
        """Return when a number of a kind was first published after a time (ns), or None."""
        self._read()
        times, numbers = self._times.get(what, []), self._numbers.get(what, [])
        for at in range(bisect_right(times, since_ns), len(times)):
            if numbers[at] == number:
                return times[at]
        return None

    def _read(self) -> None:
        if not self._path.exists():
            return
        with self._path.open() as file:
            file.seek(self._offset)
            whole, newline, _ = file.read().rpartition("\n")
        self._offset += len(whole) + len(newline)
        for line in whole.splitlines():
            what, time_ns, number = line.split()
            self._times.setdefault(what, []).append(int(time_ns))
            self._numbers.setdefault(what, []).append(float(number))
