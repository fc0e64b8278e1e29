"""Runs `robbie top` beside a run while the run is measured."""

import contextlib
import os
import subprocess
import threading
from collections.abc import Iterator

from tools.robot import COMMAND, Robot

BETWEEN_LOOKS_S = 1.0
END_LIMIT_S = 5.0
READ_BYTES = 65536


@contextlib.contextmanager
def watched(robot: Robot) -> Iterator[None]:
    """Run `robbie top` in a pseudo-terminal until the block ends.

    If `robbie top` ends early, run `robbie top --once` every second instead.
    """
    robot.wait_for(robot.attach, "no run appeared")
    ends = threading.Event()
    thread = threading.Thread(target=_watch, args=(robot, ends))
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()


def _watch(robot: Robot, ends: threading.Event) -> None:
    command = [*COMMAND, "top", "--run", robot.run_id]
    _stay(command, robot.environment, ends)
    while not ends.wait(BETWEEN_LOOKS_S):
        subprocess.run([*command, "--once"], env=robot.environment, capture_output=True, check=False)


def _stay(command: list[str], environment: dict[str, str], ends: threading.Event) -> None:
    """Run a command in a pseudo-terminal until `ends` is set or the command ends."""
    terminal, inner = os.openpty()
    process = subprocess.Popen(command, env=environment, stdin=inner, stdout=inner, stderr=inner)
    os.close(inner)
    reader = threading.Thread(target=_discard, args=(terminal,))
    reader.start()
    while process.poll() is None and not ends.wait(BETWEEN_LOOKS_S):
        pass
    process.terminate()
    try:
        process.wait(END_LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    reader.join()
    os.close(terminal)


def _discard(terminal: int) -> None:
    """Read and discard the output until the last process has closed the terminal."""
    with contextlib.suppress(OSError):  # Linux reports the closed terminal as an error
        while os.read(terminal, READ_BYTES):
            pass
