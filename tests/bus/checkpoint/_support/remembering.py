"""A module for whole runs that counts its ticks over all its incarnations."""

import os
import signal

import numpy as np

from robbie_mp import Module, setting


class Remembering(Module):
    """Counts ticks, kills itself at some of them, and ends when it has counted enough."""

    period_s: float = setting(0.002, "time between ticks")
    until: int = setting(20, "number of ticks after which it ends")
    dies_at: list[int] = setting([], "kills itself at these ticks, before the checkpoint")
    elements: int = setting(1000, "of the array in its state")

    def setup(self) -> None:
        state = self.restored or {"count": 0, "lives": 0, "array": np.zeros(self.elements, np.int64)}
        self.count = state["count"]
        self.lives = state["lives"] + 1
        self.array = state["array"]
        assert (self.array == self.count).all(), "half of a checkpoint"
        self.note(f"begins at {self.count}, life {self.lives}")

    def tick(self) -> None:
        if self.count >= self.until:
            self.stop()
            return
        self.count += 1
        self.array += 1
        marker = self.output_directory / f"{self.name}.died.{self.count}"
        if self.count in self.dies_at and not marker.exists():
            marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        self.checkpoint({"count": self.count, "lives": self.lives, "array": self.array})

    def teardown(self) -> None:
        self.note(f"ends at {self.count}, life {self.lives}")

    def note(self, text: str) -> None:
        with open(self.output_directory / f"{self.name}.journal", "a") as journal:
            journal.write(text + "\n")
