"""Plays inputs in this process, with no coverage to guide the choice: one again, or many in a fixed order."""

import contextlib
import signal
import sys
import time
import traceback
import weakref
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from random import Random
from types import FrameType

from tools.fuzz_core.attack import Attack
from tools.fuzz_core.corpus import mutate, seeds, single_mistakes

HANG_S = 20.0
AGAIN_S = 0.01


class Hang(Exception):
    """An input took too long."""


@contextlib.contextmanager
def limited(limit_s: float) -> Iterator[None]:
    """Let what is done within take only so much of the processor's time; for the main thread.

    It is told again and again: an exception in the callback of a weak reference goes nowhere.
    """

    def give_up(_signal: int, frame: FrameType | None) -> None:
        if frame is None or frame.f_code.co_filename != weakref.__file__:
            raise Hang(f"still not done after {limit_s:g} s")

    before = signal.signal(signal.SIGVTALRM, give_up)
    signal.setitimer(signal.ITIMER_VIRTUAL, limit_s, AGAIN_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)


def finding(data: bytes, limit_s: float = HANG_S) -> Exception | None:
    """Play an input; return what was found, None if nothing was."""
    try:
        with limited(limit_s):
            Attack(data).run()
    except Exception as error:
        return error
    return None


def inputs(seed: int) -> Iterator[bytes]:
    """Yield the seeds, then all single mistakes shuffled, then mutations of both without end."""
    random = Random(seed)
    mistakes = list(single_mistakes())
    random.shuffle(mistakes)
    yield from chain(known := seeds(), mistakes)
    while True:
        yield mutate(random.choice(known if random.random() < 0.5 else mistakes), random, known)


def repeat(file: Path) -> int:
    """Play one input again and say what it finds; return 0 if nothing, else 1."""
    found = finding(file.read_bytes())
    if found is None:
        print(f"no finding in {file}")
        return 0
    traceback.print_exception(found)
    return 1


def search(seconds: float, seed: int, folder: Path) -> int:
    """Play inputs for a while or until one finds something, which is then kept; return 0 or 1."""
    end_s = time.monotonic() + seconds
    played = 0
    for data in inputs(seed):
        if time.monotonic() > end_s:
            break
        played += 1
        if found := finding(data):
            kept = folder / f"finding-{seed}-{played}"
            kept.write_bytes(data)
            traceback.print_exception(found)
            print(f"{played} executions, finding kept in {kept}", file=sys.stderr)
            return 1
    print(f"{played} executions, no finding")
    return 0
