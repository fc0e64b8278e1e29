"""Modules that end in every bad way; copied into a test's workspace."""

import ctypes
import os
import signal
import sys
import time

import numpy as np

from robbie_mp import Module, setting
from robbie_mp.messages import Point


class Source(Module):
    """Publishes points for ever."""

    period_s: float = setting(0.02, "between points")

    def setup(self) -> None:
        self.sent = 0

    def tick(self) -> None:
        self.sent += 1
        self.publish(Point(x=float(self.sent)), topic="front")
        self.log.debug("point %d", self.sent)


class Ending(Module):
    """Says something at the third point, and ends."""

    how: str = setting("", "in which way")

    def setup(self) -> None:
        self.seen = 0
        self.subscribe(Point, self.on_point, topic="front")

    def on_point(self, point: Point) -> None:
        self.seen += 1
        if self.seen == 3:
            self.status = f"ends by {self.how}"
            self.log.warning("about to end <b>by</b> %s", self.how)
            sys.stdout.write(f"last words of {self.how}, with no end of l")
            getattr(self, self.how)()

    def null_pointer(self) -> None:
        ctypes.string_at(0)

    def exit(self) -> None:
        os._exit(7)

    def memory(self) -> None:
        self.big = np.ones(1 << 33)

    def sigkill(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def exception(self) -> None:
        raise ValueError("no such <script>device</script>")

    def hang(self) -> None:
        wait_for_a_device(self)


def wait_for_a_device(module: Module) -> None:
    while True:
        time.sleep(1)
