"""Keeps `robbie top` looking at a run while it is measured."""

import contextlib
import os
import subprocess
import threading
from collections.abc import Iterator

from tools.kill_campaign.robot import COMMAND, Robot

BETWEEN_LOOKS_S = 1.0
END_LIMIT_S = 5.0
READ_BYTES = 65536


@contextlib.contextmanager
def watched(robot: Robot) -> Iterator[None]:
    """Show the run in a terminal of its own until the block ends.

    Where `robbie top` cannot stay, `robbie top --once` looks once a second.
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
    """Run a command that draws on a terminal until the end, or until it ends itself."""
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
    """Read what is drawn until nobody has the terminal any more."""
    with contextlib.suppress(OSError):  # how Linux says so
        while os.read(terminal, READ_BYTES):
            pass
