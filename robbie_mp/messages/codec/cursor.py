"""The position in the buffer, as far as the code generator knows it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

from robbie_mp.messages.codec.placement import (
    LARGEST_ALIGNMENT,
    Placement,
    loop_positions,
    padding,
    place,
    positions_after_numbers,
)
from robbie_mp.messages.codec.plan import Loop, Run
from robbie_mp.messages.codec.source import Source


class Cursor:
    """The position of the generated code: a number known now, or the future value of the variable `_i`.

    Args:
        source: gets the lines that move `_i`.
    """

    def __init__(self, source: Source):
        self._source = source
        self._known: int | None = 0
        self._starts = frozenset({0})

    @property
    def expression(self) -> str:
        """The position in the generated code."""
        return "_i" if self._known is None else str(self._known)

    def placements(self, run: Run) -> dict[int, Placement]:
        """Return the placement of a run for each position modulo 8 that is possible here."""
        return {start: place(run.items, start) for start in self._starts}

    def advance(self, size: int) -> None:
        """Move on by a number of bytes known now."""
        self._starts = frozenset((start + size) % LARGEST_ALIGNMENT for start in self._starts)
        if self._known is None:
            self._source.line(f"_i += {size}")
        else:
            self._known += size

    def advance_by_table(self, placements: dict[int, Placement], size: str) -> None:
        """Move on by the value of the expression `size`, which depends on the position."""
        self._starts = frozenset((start + at.size) % LARGEST_ALIGNMENT for start, at in placements.items())
        self._source.line(f"_i += {size}")

    def move_past_text(self, stop: str) -> None:
        """Move on to the value of the expression `stop`, which is unknown now."""
        self._known, self._starts = None, frozenset(range(LARGEST_ALIGNMENT))
        self._source.line(f"_i = {stop}")

    def materialise(self) -> None:
        """Keep the position in `_i` from here on, because branches or loops follow."""
        if self._known is not None:
            self._source.line(f"_i = {self._known}")
            self._known = None

    def align_numbers(self, size: int, *before: str) -> None:
        """Move `_i` over the gap before the elements of a sequence, if there can be one.

        A length word comes before, so the position is a multiple of four: only 8-byte elements can have a
        gap, and it is four bytes.

        Args:
            size: of an element.
            before: lines that handle the gap before it is passed.
        """
        gaps = {padding(start, size) for start in self._starts}
        if gaps == {0}:
            return
        with self._source.block("if _i & 7 != 4:") if 0 in gaps else nullcontext():
            for line in (*before, "_i += 4"):
                self._source.line(line)

    def move_past_numbers(self, size: int) -> None:
        """Account for a sequence, possibly empty, with elements of this size."""
        self._starts = positions_after_numbers(size, self._starts)

    @contextmanager
    def loop(self, loop: Loop) -> Iterator[None]:
        """Account for the positions possible in the loop's body, and after a loop without elements."""
        self.materialise()
        self._starts = possible = loop_positions(loop, self._starts)
        yield
        self._starts = possible
