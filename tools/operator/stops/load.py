"""Overloads the machine: one process per processor never sleeps, and one module dies often."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tools.operator.stops.scene import Scene

KILL_EVERY_S = 3.0
# The child reads a pipe of this process, and so ends with this process.
BUSY = """import os, threading
threading.Thread(target=lambda: (os.read(0, 1), os._exit(0))).start()
while True: pass"""


@contextmanager
def full_load(scene: Scene) -> Iterator[None]:
    """Keep all processors busy, and kill mapping every few seconds."""
    busy = [
        subprocess.Popen([sys.executable, "-c", BUSY], stdin=subprocess.PIPE) for _ in os.sched_getaffinity(0)
    ]
    ended = threading.Event()

    def kill() -> None:
        while not ended.wait(KILL_EVERY_S):
            if pid := scene.pid("mapping"):  # 0: it is not running
                scene.robot.send(pid, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        yield
    finally:
        ended.set()
        killer.join()
        for process in busy:
            process.kill()
            process.communicate()
