"""Traces of the test build: every store in turn, by Python or by C, and that both are the same."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from itertools import zip_longest
from types import ModuleType

from tests.bus.core._support.simulated_run import SimulatedRun
from tests.bus.hot._support.memory import FusedMemory

ENTRY = struct.Struct("=IIQ")
WAKE = 2**32 - 1
SHOWN = 12
"""Stores that are shown before the first difference."""


def described(trace: bytes) -> list[str]:
    """Say what was stored where, one line for each store."""
    return [
        f"woke {value}" if words == WAKE else f"words {words}: [{index}] = {value:#x}"
        for words, index, value in ENTRY.iter_unpack(trace)
    ]


@dataclass
class Played:
    """The outcome of a simulated run."""

    trace: bytes
    error: str
    """The error it raised: a violation that only one of the two finds is a difference, too."""


def played(
    built: ModuleType, play: Callable[[], object], *, with_c: bool, look_everywhere: bool = True
) -> Played:
    """Let a simulated run be played over the test build's memory, by Python or by C.

    Args:
        built: the test build.
        play: plays it.
        with_c: whether C plays it.
        look_everywhere: whether to look for words that were stored beside the macro in all memory, also that
            of earlier runs, or only in pages that were stored into, which is faster.
    """
    before, SimulatedRun.memory = SimulatedRun.memory, FusedMemory(built, with_c=with_c)
    built.begin_trace()
    error, kept = "", None
    try:
        kept = play()
    except Exception as raised:
        error = f"{type(raised).__name__}: {raised}"
    finally:
        trace: bytes = built.end_trace()
        SimulatedRun.memory = before
    assert built.stray_words(not look_everywhere) == [], "stored beside the macro"
    assert built.unguarded_stores() == 0, "a binding stores, but does not say MAY_DIE"
    del kept
    return Played(trace, error)


def difference(built: ModuleType, play: Callable[[], object], *, look_everywhere: bool = True) -> str:
    """Play a run in Python and in C; say how their stores differ, '' if they do not."""
    python, c = (
        played(built, play, with_c=with_c, look_everywhere=look_everywhere) for with_c in (False, True)
    )
    if python == c:
        return ""
    lines = []
    for number, (ours, theirs) in enumerate(
        zip_longest(described(python.trace), described(c.trace), fillvalue="")
    ):
        if ours != theirs:
            before = described(python.trace)[max(0, number - SHOWN) : number]
            lines = [*before, f"store {number}: Python {ours or 'has ended'}, C {theirs or 'has ended'}"]
            break
    return "\n".join([*lines, f"Python: {python.error or 'no error'}", f"C: {c.error or 'no error'}"])
