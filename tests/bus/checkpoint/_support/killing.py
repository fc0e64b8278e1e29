"""Really kills processes while they store: before each line in turn, and at any moment.

Runs in a separate process, as `python -m tests.bus.checkpoint._support.killing SCENARIO`, because it forks
and a test's process has threads. An AssertionError names the death after which a checkpoint was lost.
Otherwise, it prints the number of deaths.
"""

import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from robbie_mp.bus.checkpoint.buffers import CheckpointBuffers
from robbie_mp.bus.checkpoint.file import read_file, write_file
from robbie_mp.bus.checkpoint.image import encode, lay_out
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.segment import unlink_segment
from robbie_mp.bus.transport.shared_folder import make_folder, remove_names

TRACED = (
    "robbie_mp/bus/checkpoint/",
    "robbie_mp/bus/transport/segment.py",
    "robbie_mp/base/linux/private_files.py",
)


def run_of(pid: int) -> str:
    """Return the run in whose memory the process with this pid has its checkpoints."""
    return f"test{pid}"


RUN = run_of(os.getpid())  # not a possible id of a run: another `robbie run` would sweep it as dead
LIMIT_BYTES = 64 << 20
RANDOM_DEATHS = 40
LONGEST_LIFE_S = 0.02


Action = Callable[[], None]


def dies_before_line(number: int, prepare: Callable[[], Action]) -> bool:
    """Run an action in a process that is killed before a given line; False if the action ended before."""
    pid = os.fork()
    if pid == 0:
        _run_and_die(number, prepare)
    status = os.waitpid(pid, 0)[1]
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, "the action failed by itself"
    return os.WIFSIGNALED(status)


def _run_and_die(number: int, prepare: Callable[[], Action]) -> None:
    left = number

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal left
        if not any(part in frame.f_code.co_filename for part in TRACED):
            return None
        if event == "line":
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            left -= 1
        return trace

    try:
        act = prepare()
        sys.settrace(trace)
        act()
        sys.settrace(None)
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def dies_at_random(store_repeatedly: Callable[[Action], None], stores: int) -> None:
    """Run an action that has no end in a process that is killed at some moment.

    Args:
        store_repeatedly: the action; it calls its argument after each store.
        stores: how many it finishes before, however slow the machine or its disk is.
    """
    receiver, sender = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            store_repeatedly(lambda: _tell(sender))
        finally:
            os._exit(1)
    os.close(sender)
    with open(receiver, "rb", buffering=0) as finished:
        for _ in range(stores):
            assert finished.read(1), "the action failed by itself"
        time.sleep(random.uniform(0, LONGEST_LIFE_S))  # the moment is what varies
        os.kill(pid, signal.SIGKILL)
        assert os.WIFSIGNALED(os.waitpid(pid, 0)[1]), "the action failed by itself"


def _tell(sender: int) -> None:
    os.write(sender, b".")


def state_of(number: int, size: int) -> dict[str, Any]:
    return {"number": number, "array": np.full(size, number), "name": f"checkpoint {number}"}


def number_in(state: Any) -> int:
    """Return the number of a state, all parts of which must belong together."""
    assert (state["array"] == state["number"]).all(), "half of one checkpoint, half of another"
    assert state["name"] == f"checkpoint {state['number']}"
    return int(state["number"])


class Incarnation:
    """A process with shared-memory checkpoints."""

    def __init__(self, number: int):
        self.buffers = CheckpointBuffers(RUN, 1, number, LIMIT_BYTES)
        assert self.buffers.damaged == []
        self.found = 0 if self.buffers.found is None else number_in(self.buffers.found.state)

    def save(self, number: int, size: int) -> None:
        self.buffers.write(lay_out(state_of(number, size)), 0)

    def __enter__(self) -> "Incarnation":
        return self

    def __exit__(self, *_error: object) -> None:
        self.buffers.close()


def forget() -> None:
    """Remove all checkpoints in memory."""
    for number in (0, 1):
        unlink_segment(names.checkpoint(RUN, 1, number))


def buffers_at_every_line(sizes: list[int]) -> int:
    """Kill the writer of the last of these states. Its successor must find that state or the previous one."""
    before, number = sizes[:-1], len(sizes)

    def last() -> Action:
        dying = Incarnation(2)
        state = lay_out(state_of(number, sizes[-1]))
        return lambda: dying.buffers.write(state, 0)

    deaths = 0
    died = True
    while died:
        with Incarnation(1) as first:
            for index, size in enumerate(before):
                first.save(index + 1, size)
        died = dies_before_line(deaths, last)
        with Incarnation(3) as successor:
            assert successor.found in ((number - 1, number) if died else (number,)), f"after death {deaths}"
            successor.save(number + 1, sizes[-1])
        with Incarnation(4) as reader:
            assert reader.found == number + 1
        forget()
        deaths += died
    return deaths


def buffers_at_random() -> int:
    """Kill writers that store one large state after another. No stored state may be lost."""
    with tempfile.TemporaryFile() as stored:

        def store_repeatedly(has_stored: Action) -> None:
            with Incarnation(1) as dying:
                number = dying.found
                while True:
                    number += 1
                    dying.save(number, 200_000 + number * 1000)  # it grows from time to time
                    os.pwrite(stored.fileno(), number.to_bytes(8, "little"), 0)
                    has_stored()

        found = 0
        for death in range(RANDOM_DEATHS):
            dies_at_random(store_repeatedly, death % 2)
            # A writer that died before it could note its last store is one ahead.
            told = max(found, int.from_bytes(os.pread(stored.fileno(), 8, 0), "little"))
            with Incarnation(1) as successor:
                found = successor.found
            assert found in (told, told + 1), f"death {death}: {told} told, {found} found"
    assert told > 0, "all died before they had stored anything"
    forget()
    return RANDOM_DEATHS


def file_at_every_line(folder: Path) -> int:
    """Kill the writer of a file. Either the old file or the new one must remain."""
    path = folder / "new" / "folders" / "module.checkpoint"
    deaths = {}
    for number in (1, 2):
        deaths[number] = 0
        died = True
        while died:
            image = encode(state_of(number, 100))
            died = dies_before_line(deaths[number], partial(partial, write_file, path, image))
            found = read_file(path)
            assert (0 if found is None else number_in(found.state)) in (number - 1, number)
            assert len(list(folder.rglob("*.new"))) <= died
            deaths[number] += died
            if found is not None and number == 1:
                path.unlink()
        write_file(path, encode(state_of(number, 100)))
    return sum(deaths.values())


def file_at_random(folder: Path) -> int:
    """Kill writers of large files. There must always be a complete file, and never an older one."""
    path = folder / "module.checkpoint"
    newest = 0

    def store_repeatedly(has_stored: Action) -> None:
        number = newest
        while True:
            number += 1
            write_file(path, encode(state_of(number, 200_000)))
            has_stored()

    unfinished = 0
    for death in range(RANDOM_DEATHS):
        stores = death % 2
        dies_at_random(store_repeatedly, stores)
        unfinished += len(list(folder.glob("*.new")))
        found = read_file(path)
        number = 0 if found is None else number_in(found.state)
        assert number >= newest + stores
        newest = number
        assert len(list(folder.iterdir())) <= 2, "what a killed writer leaves is removed by the next one"
    assert newest > 0, "all died before they had stored anything"
    assert unfinished > 0, "none died while it wrote"
    return RANDOM_DEATHS


def main(scenario: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        make_folder(RUN)
        scenarios: dict[str, Callable[[], int]] = {
            "first": lambda: buffers_at_every_line([10]),
            "second": lambda: buffers_at_every_line([10, 10]),
            "third": lambda: buffers_at_every_line([10, 10, 10]),
            "larger": lambda: buffers_at_every_line([10, 10, 5000]),
            "smaller": lambda: buffers_at_every_line([5000, 5000, 10]),
            "at random": buffers_at_random,
            "file": lambda: file_at_every_line(Path(folder)),
            "file at random": lambda: file_at_random(Path(folder)),
        }
        try:
            print(scenarios[scenario]())
        finally:
            remove_names(RUN)


if __name__ == "__main__":
    main(sys.argv[1])
