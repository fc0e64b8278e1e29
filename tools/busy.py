"""Keeps processors busy, to see what a robot or a device does meanwhile."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# The child reads a pipe of this process, and so ends with this process.
SPIN = """import os, threading
threading.Thread(target=lambda: (os.read(0, 1), os._exit(0))).start()
while True: pass"""


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Run processes that compute all the time, each in a session of its own, as modules are."""
    command = [sys.executable, "-c", SPIN]
    made = [
        subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True) for _ in range(processes)
    ]
    try:
        yield
    finally:
        for one in made:
            one.kill()
            one.communicate()
