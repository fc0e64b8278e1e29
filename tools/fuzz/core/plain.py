"""Plays inputs in this process without guidance by coverage: a single one, or many in a fixed order."""

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

from tools.fuzz.core.attack import SimulatedAttack
from tools.fuzz.core.corpus import mutate, seeds, single_mistakes

HANG_S = 20.0
AGAIN_S = 0.01


class Hang(Exception):
    """An input took too long."""


@contextlib.contextmanager
def limited(limit_s: float) -> Iterator[None]:
    """Raise `Hang` when the block takes more than a limit of processor time. Use it in the main thread.

    The signal repeats, because an exception in the callback of a weak reference is ignored.
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
    """Play an input; return the finding, or None."""
    try:
        with limited(limit_s):
            SimulatedAttack(data).run()
    except Exception as error:
        return error
    return None


def inputs(seed: int) -> Iterator[bytes]:
    """Yield the seeds, then all single mistakes in random order, then mutations of both without end."""
    random = Random(seed)
    mistakes = list(single_mistakes())
    random.shuffle(mistakes)
    yield from chain(known := seeds(), mistakes)
    while True:
        yield mutate(random.choice(known if random.random() < 0.5 else mistakes), random, known)


def repeat(file: Path) -> int:
    """Play one input and print its finding. Return 1 if there is one, else 0."""
    found = finding(file.read_bytes())
    if found is None:
        print(f"no finding in {file}")
        return 0
    traceback.print_exception(found)
    return 1


def search(seconds: float, seed: int, folder: Path) -> int:
    """Play inputs for a time or until a finding, whose input is kept. Return 1 if there is one, else 0."""
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
