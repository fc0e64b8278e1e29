"""Feeds one reader with damaged inputs, in a process with a limit of time and memory."""

import importlib
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import NamedTuple

from robbie_mp.base.errors import RobbieError
from tools.fuzz.readers.mutation import mutated

HANG_S = 20.0
"""A reader that takes longer for one input hangs. On an idle machine the slowest takes less than a second."""
MEMORY_BYTES = 1 << 30
"""Address space that a reader may take beyond what the process has when it has imported everything."""
START_S = 120.0
MAX_KINDS = 20
MAX_LOST = 20
"""After this number of hangs and deaths, a reader gets no more inputs."""
MEBIBYTE = 1 << 20

Files = dict[str, bytes]
"""The files of an input by their names; one of them is damaged."""


class ReaderUnderTest(NamedTuple):
    """A reader under test.

    Attributes:
        seeds: makes valid inputs.
        read: reads the input in a folder, to its last value.
        refusals: the errors with which the reader may refuse an input.
        tokens: words that mean something to it.
    """

    seeds: Callable[[], list[Files]]
    read: Callable[[Path], object]
    refusals: tuple[type[Exception], ...] = (RobbieError,)
    tokens: tuple[bytes, ...] = ()


@dataclass
class ReaderResult:
    """What became of the damaged inputs of a reader.

    Attributes:
        damaged_bytes: bytes of the damaged files.
        inputs: number of inputs.
        accepted: inputs that were read.
        refused: inputs that were refused with an error of ours.
        failures: how often each other error came, a hang or a death, with the number of the first input.
        slowest_s: the longest time for one input.
        peak_bytes: most memory that the process had beyond what it began with.
        lost: processes that hung or died.
    """

    damaged_bytes: int = 0
    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    failures: dict[str, list[int]] = field(default_factory=dict)
    slowest_s: float = 0.0
    peak_bytes: int = 0
    lost: int = 0

    def fail(self, what: str, number: int) -> None:
        """Note a failure; beyond `MAX_KINDS` different ones they count as one kind."""
        if what not in self.failures and len(self.failures) >= MAX_KINDS:
            what = "others"
        self.failures.setdefault(what, []).append(number)


class Task(NamedTuple):
    """What a process does: see `run`; `begin` is the number of the first input."""

    name: str
    subjects: str
    damaged_bytes: int
    seed: int
    begin: int


class _Outcome(NamedTuple):
    number: int
    size: int
    seconds: float
    failure: str | None
    is_accepted: bool
    peak_bytes: int


def run(name: str, subjects: str, damaged_bytes: int, seed: int = 0) -> ReaderResult:
    """Feed one reader.

    Args:
        name: of the reader.
        subjects: the function that returns all readers, as `package.module:function`.
        damaged_bytes: at least this many.
        seed: of the damage; the same seed gives the same inputs.
    """
    result, begin = ReaderResult(), 0
    while result.damaged_bytes < damaged_bytes and result.lost < MAX_LOST:
        wanted = damaged_bytes - result.damaged_bytes
        begin = _run_process(Task(name, subjects, wanted, seed, begin), result)
    return result


def damaged_input(reader: ReaderUnderTest, seeds: list[Files], seed: int, number: int) -> tuple[Files, int]:
    """Return an input by its number, and the size of the damaged file."""
    random = Random(f"{seed}/{number}")
    files = dict(random.choice(seeds))
    name = random.choice(sorted(files))
    files[name] = mutated(files[name], random, reader.tokens)
    return files, max(1, len(files[name]))


def _run_process(task: Task, result: ReaderResult) -> int:
    """Feed the reader until all is done, or the process hangs or dies; return the next input's number."""
    ours, theirs = os.pipe()
    command = [sys.executable, "-m", __name__, str(theirs), json.dumps(task)]
    process = subprocess.Popen(
        command, pass_fds=[theirs], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    os.close(theirs)
    try:
        with Connection(ours, writable=False) as connection:
            return _follow(connection, task.begin, result)
    finally:
        process.kill()
        process.wait()


def _follow(connection: Connection, number: int, result: ReaderResult) -> int:
    limit_s = START_S
    while True:
        try:
            if not connection.poll(limit_s):
                return _lost(f"hangs: no answer for {limit_s:g} s", number, result)
            answer = connection.recv()
        except (EOFError, OSError):
            return _lost("the process died", number, result)
        if answer is None:
            return number
        if isinstance(answer, str):
            raise RuntimeError(answer)
        limit_s = HANG_S
        outcome = _Outcome(*answer)
        _note(outcome, result)
        number = outcome.number + 1


def _lost(what: str, number: int, result: ReaderResult) -> int:
    result.fail(what, number)
    result.inputs += 1
    result.lost += 1
    return number + 1


def _note(outcome: _Outcome, result: ReaderResult) -> None:
    result.inputs += 1
    result.damaged_bytes += outcome.size
    result.accepted += outcome.is_accepted
    result.refused += not outcome.is_accepted and outcome.failure is None
    result.peak_bytes = max(result.peak_bytes, outcome.peak_bytes)
    result.slowest_s = max(result.slowest_s, outcome.seconds)
    if outcome.failure is not None:
        result.fail(outcome.failure, outcome.number)


def serve(task: Task, connection: Connection) -> None:
    """Read damaged inputs in a process of its own."""
    warnings.simplefilter("ignore")
    module, _, function = task.subjects.partition(":")
    reader: ReaderUnderTest = getattr(importlib.import_module(module), function)()[task.name]
    seeds = reader.seeds()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        if problem := _first_problem(reader, seeds, Path(folder)):
            connection.send(problem)
            return
        _limit_memory()
        _read_all(reader, seeds, Path(folder), task, connection)
        connection.send(None)


def _first_problem(reader: ReaderUnderTest, seeds: list[Files], folder: Path) -> str:
    """Return why a valid input is not read; '' if all are. This also imports what the reader needs."""
    for files in seeds:
        try:
            reader.read(_written(files, folder))
        except Exception:
            return f"a valid input is refused: {traceback.format_exc()}"
    return ""


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _read_all(
    reader: ReaderUnderTest, seeds: list[Files], folder: Path, task: Task, connection: Connection
) -> None:
    number, done, first_bytes = task.begin, 0, _peak_bytes()
    while done < task.damaged_bytes:
        files, size = damaged_input(reader, seeds, task.seed, number)
        inside = _written(files, folder)
        began_s = time.perf_counter()
        failure, is_accepted = _read(reader, inside)
        seconds = time.perf_counter() - began_s
        peak = _peak_bytes() - first_bytes
        connection.send((number, size, seconds, failure, is_accepted, peak))
        done += size
        number += 1


def _read(reader: ReaderUnderTest, folder: Path) -> tuple[str | None, bool]:
    """Return the failure, if there is one, and whether the input was accepted."""
    try:
        reader.read(folder)
    except reader.refusals:
        return None, False
    except BaseException as error:  # also SystemExit, KeyboardInterrupt and MemoryError
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} in {Path(frame.filename).name}:{frame.lineno}: {error!s:.120}", False
    return None, True


def _written(files: Files, folder: Path) -> Path:
    """Write an input into an empty folder, and return that folder."""
    inside = folder / "input"
    shutil.rmtree(inside, ignore_errors=True)
    for name, data in files.items():
        file = inside / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    return inside


def _peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


if __name__ == "__main__":
    with Connection(int(sys.argv[1]), readable=False) as pipe:
        serve(Task(*json.loads(sys.argv[2])), pipe)
