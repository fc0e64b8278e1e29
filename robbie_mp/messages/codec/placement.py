"""The offsets of the items of a run, for every position where it may start."""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct
from typing import NamedTuple

from robbie_mp.messages.codec.plan import (
    Filler,
    FixedNumbers,
    Loop,
    NumbersBody,
    Plan,
    Run,
    RunItem,
    TextBody,
)

LARGEST_ALIGNMENT = 8
ENCAPSULATION_SIZE = 4  # bytes; alignment counts from the body behind it


class Placement(NamedTuple):
    """A run laid out for one start position.

    Attributes:
        packing: writes the run: fixed arrays as bytes.
        unpacking: reads the run: fixed arrays left out.
        size: bytes, with the padding before and between the items.
        array_offsets: where each fixed array begins, counted from the start of the run.
    """

    packing: Struct
    unpacking: Struct
    size: int
    array_offsets: tuple[int, ...]


def padding(position: int, alignment: int) -> int:
    """Return the bytes to skip from `position`, counted from the encapsulation, to an aligned one."""
    return (ENCAPSULATION_SIZE - position) % alignment


def place(items: Sequence[RunItem], start: int) -> Placement:
    """Lay the items out from `start`, counted from the encapsulation (modulo 8 is enough)."""
    position, pack, unpack, arrays = start, "<", "<", []
    for item in items:
        gap = "x" * padding(position, item.primitive.size)
        position += len(gap)
        if isinstance(item, FixedNumbers):
            arrays.append(position - start)
            pack += f"{gap}{item.size}s"
            unpack += f"{gap}{item.size}x"
            position += item.size
        else:
            code = "x" if isinstance(item, Filler) else item.primitive.code
            pack += gap + code
            unpack += gap + code
            position += item.primitive.size
    return Placement(Struct(pack), Struct(unpack), position - start, tuple(arrays))


def positions_after(plan: Plan, starts: frozenset[int]) -> frozenset[int]:
    """Return where the steps may end, modulo 8, if they may start at `starts`."""
    for step in plan.steps:
        match step:
            case Run():
                starts = frozenset(
                    (start + place(step.items, start).size) % LARGEST_ALIGNMENT for start in starts
                )
            case TextBody():
                starts = frozenset(range(LARGEST_ALIGNMENT))
            case NumbersBody():
                starts = positions_after_numbers(step.element.size, starts)
            case Loop():
                starts = loop_positions(step, starts)
    return starts


def positions_after_numbers(size: int, starts: frozenset[int]) -> frozenset[int]:
    """Return where a sequence of elements of this size may end; an empty one has no padding."""
    ends = {
        (start + padding(start, size) + count * size) % LARGEST_ALIGNMENT
        for start in starts
        for count in range(LARGEST_ALIGNMENT)
    }
    return starts | ends


def loop_positions(loop: Loop, starts: frozenset[int]) -> frozenset[int]:
    """Return where an element of the loop, or what follows the loop, may start."""
    while not (ends := positions_after(loop.body, starts)) <= starts:
        starts |= ends
    return starts
