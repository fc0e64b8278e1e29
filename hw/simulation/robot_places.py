"""Where the robots are that share an arena, each simulated by its own program on this machine."""

import os
import struct
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.pose import Pose

FORMAT = struct.Struct("<Q4dQ")  # sequence, x, y, heading, time, sequence
STALE_S = 5.0
LOOK_S = 1.0
MOST_ROBOTS = 64
SUFFIX = ".place"


class RobotPlaces:
    """The places of robots in a folder: each robot writes its own file, and reads those of the others.

        places = RobotPlaces(Path("/tmp/arena"), "red")
        places.tell(Pose(1.0, 2.0, 0.0))
        places.others()   # x, y of every other robot

    A robot that has sent nothing for 5 s is no longer in the arena.

    Args:
        folder: the folder; it is made if it does not exist.
        robot: name of this robot, as part of a file's name.
    """

    def __init__(self, folder: Path, robot: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._own = folder / f"{robot}{SUFFIX}"
        self._others: list[Path] = []
        self._look_s = -np.inf
        self._count = 0

    def tell(self, pose: Pose) -> None:
        """Write where this robot is, arena frame."""
        self._count += 1
        row = FORMAT.pack(self._count, *pose, time.monotonic(), self._count)
        flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW  # others may write there, too
        file = os.open(self._own, flags, 0o600)
        try:
            os.pwrite(file, row, 0)
        finally:
            os.close(file)

    def others(self) -> NDArray[np.float64]:
        """Return where the other robots are: `(N, 2)`, x and y, m, arena frame."""
        now_s = time.monotonic()
        if now_s - self._look_s >= LOOK_S:
            self._look_s = now_s
            found = sorted(self._folder.glob(f"*{SUFFIX}"))
            self._others = [file for file in found if file != self._own][:MOST_ROBOTS]
        places = [place for file in self._others if (place := _read(file, now_s)) is not None]
        return np.array(places, float).reshape(-1, 2)

    def leave(self) -> None:
        """Take this robot out of the arena."""
        self._own.unlink(missing_ok=True)


def _read(file: Path, now_s: float) -> tuple[float, float] | None:
    """Return a robot's x and y (m); None if it is not there, or just being written."""
    try:
        row = file.read_bytes()
    except OSError:
        return None
    if len(row) != FORMAT.size:
        return None
    first, x_m, y_m, _, told_s, last = FORMAT.unpack(row)
    return (x_m, y_m) if first == last and 0 <= now_s - told_s < STALE_S else None
