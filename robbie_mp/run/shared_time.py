"""One simulated time for several runs on this machine, such as those of the robots of a team.

Each run writes into a folder to which time it wants to go next, and goes there only when no other run is left
behind. So the clocks of all runs differ by at most one step of the slowest and `LEAD_NS`.
"""

import os
import struct
import time
from pathlib import Path

FORMAT = struct.Struct("<QQdQ")  # sequence, next time in ns, when it was written, sequence
LEAD_NS = 10_000_000
"""A run may be so far ahead of the others, so that they need not wait for one another at each tick."""
STALE_S = 20.0
"""A run that has written nothing for this long is dead; the others go on without it."""
LOOK_S = 0.1
MAX_RUNS = 64
SUFFIX = ".time"


class SharedTime:
    """The times of all runs that share a folder.

        shared = SharedTime(Path("/tmp/arena"), "red", waits_for=2)
        if shared.may_go_to(due_ns):
            clock.pause(due_ns)

    Args:
        folder: the folder; it is made if it does not exist.
        run: name of this run, as part of a file's name.
        waits_for: number of runs, including this one, that must be present before time passes.

    Attributes:
        has_begun: whether at least `waits_for` runs have been present at the same time.
    """

    def __init__(self, folder: Path, run: str, waits_for: int = 1) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._own = folder / f"{run}{SUFFIX}"
        self._waits_for = waits_for
        self.has_begun = False
        self._others: list[Path] = []
        self._look_s = -float("inf")
        self._count = 0
        self._free_until_ns = -1
        """No other run was behind this time when it was last read."""

    def may_go_to(self, due_ns: int) -> bool:
        """Tell the other runs to which time this one wants to go; return whether it may.

        Call it again soon if not: a run that tells nothing counts as dead.

        Args:
            due_ns: a time not before the last one.
        """
        self._tell(due_ns)
        if due_ns <= self._free_until_ns:
            return True
        now_s = time.monotonic()
        if now_s - self._look_s >= LOOK_S or not self.has_begun:
            self._look_s = now_s
            found = sorted(self._folder.glob(f"*{SUFFIX}"))
            self._others = [file for file in found if file != self._own][:MAX_RUNS]
            self.has_begun = self.has_begun or len(found) >= self._waits_for
        if not self.has_begun:
            return False
        times_ns = [at_ns for file in self._others if (at_ns := _read(file, now_s)) is not None]
        # Without others, look again soon, because one may begin.
        self._free_until_ns = min(times_ns, default=due_ns) + LEAD_NS
        return due_ns <= self._free_until_ns

    def leave(self) -> None:
        """Let the others go on without this run."""
        self._own.unlink(missing_ok=True)

    def _tell(self, due_ns: int) -> None:
        self._count += 1
        file = os.open(self._own, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            os.pwrite(file, FORMAT.pack(self._count, due_ns, time.monotonic(), self._count), 0)
        finally:
            os.close(file)


def _read(file: Path, now_s: float) -> int | None:
    """Return the time to which a run wants to go (ns); None if it is gone or dead.

    A file that is just being written is read again.
    """
    while True:
        try:
            row = file.read_bytes()
        except OSError:
            return None
        if not row:
            return 0  # it has just been made
        if len(row) != FORMAT.size:
            return None
        first, at_ns, told_s, last = FORMAT.unpack(row)
        if first == last:
            return int(at_ns) if now_s - told_s < STALE_S else None
