"""One simulated time for several runs on this machine, such as those of the robots of a team.

Each run writes into a folder to which time it wants to go next, and goes there only when no other run is left
behind. So the clocks of all runs differ by at most one step of the slowest and `LEAD_NS`.
"""

import os
import struct
import time
from pathlib import Path
from typing import NamedTuple

from robbie_mp.base.linux.private_files import private_opener

FORMAT = struct.Struct("<QQdQ")  # sequence, next time in ns, when it was written, sequence
LEAD_NS = 10_000_000
"""A run may be so far ahead of the others, so that they need not wait for one another at each tick."""
STALE_S = 20.0
"""A run that has written nothing for this long is dead; the others go on without it."""
AHEAD_S = 1.0
"""A run that has written in a future further away than this wrote before the machine was started again."""
LOOK_S = 0.1
READS = 100
"""Attempts to read a file that is just being written."""
MAX_RUNS = 64
SUFFIX = ".time"


class Told(NamedTuple):
    """The last that a run has reported."""

    at_ns: int
    """The time to which it wants to go."""
    told_s: float
    """When it told so, by the machine's clock."""


class SharedTime:
    """The times of all runs that share a folder.

        shared = SharedTime(Path("/tmp/arena"), "red", waits_for=2)
        if shared.may_go_to(due_ns):
            clock.pause(due_ns)

    Args:
        folder: the folder; it is made if it does not exist.
        run: name of this run, as part of a file's name.
        waits_for: number of runs, including this one, that must be present before time passes.
        stale_s: a run that has sent nothing for this long is dead; the others go on without it.

    Attributes:
        has_begun: whether at least `waits_for` runs have been present at the same time.
        missing: names of the runs that have been present since this one began, and are dead now.
        given_up: how often this run has gone on without another one that is dead.
    """

    def __init__(self, folder: Path, run: str, waits_for: int = 1, stale_s: float = STALE_S) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._own = folder / f"{run}{SUFFIX}"
        self._waits_for = waits_for
        self.stale_s = stale_s
        self.has_begun = False
        self.missing: set[str] = set()
        self.given_up = 0
        self._met: set[str] = set()
        """Names of the other runs that are present."""
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
            self._look(now_s)
        if not self.has_begun:
            return False
        found = [_read(file) for file in self._others]
        times_ns = [told.at_ns for told in found if told is not None and self._is_alive(told, now_s)]
        if len(times_ns) < len(found):
            # This run may end before the next look, and has to say first that it goes on without another one.
            self._look(now_s)
        # Without others, look again soon, because one may begin.
        self._free_until_ns = min(times_ns, default=due_ns) + LEAD_NS
        return due_ns <= self._free_until_ns

    def leave(self) -> None:
        """Let the others go on without this run."""
        self._own.unlink(missing_ok=True)

    def _look(self, now_s: float) -> None:
        """Find the other runs."""
        self._look_s = now_s
        others = [file for file in sorted(self._folder.glob(f"*{SUFFIX}")) if file != self._own]
        self._others = [file for file in others if self._is_alive(_read(file), now_s)][:MAX_RUNS]
        self._note_presence()
        self.has_begun = self.has_begun or len(self._others) + 1 >= self._waits_for

    def _is_alive(self, told: Told | None, now_s: float) -> bool:
        return told is not None and -AHEAD_S < now_s - told.told_s < self.stale_s

    def _note_presence(self) -> None:
        """Note which runs have come and died; those that have left are not missing."""
        present = {file.name.removesuffix(SUFFIX) for file in self._others}
        not_left = {run for run in self._met | self.missing if (self._folder / f"{run}{SUFFIX}").exists()}
        self.given_up += len((self._met & not_left) - present)
        self.missing = not_left - present
        self._met = present

    def _tell(self, due_ns: int) -> None:
        self._count += 1
        file = private_opener(str(self._own), os.O_WRONLY | os.O_CREAT)
        try:
            os.pwrite(file, FORMAT.pack(self._count, due_ns, time.monotonic(), self._count), 0)
        finally:
            os.close(file)


def _read(file: Path) -> Told | None:
    """Return what a run has reported; None if it is gone, or its file is damaged.

    A file that is just being written is read again.
    """
    for _ in range(READS):
        try:
            row = file.read_bytes()
            if not row:  # it has just been made
                return Told(0, time.monotonic() - max(0.0, time.time() - file.stat().st_mtime))
        except OSError:
            return None
        if len(row) != FORMAT.size:
            return None
        first, at_ns, told_s, last = FORMAT.unpack(row)
        if first == last:
            return Told(at_ns, told_s)
    return None
