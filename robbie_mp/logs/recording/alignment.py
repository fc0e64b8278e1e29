"""Finds the elements of two sequences that correspond, when either sequence lacks some.

Source: E. W. Myers, An O(ND) Difference Algorithm and Its Variations, Algorithmica 1 (1986).
"""

from collections.abc import Hashable, Iterator, Sequence
from typing import NamedTuple

EDIT_LIMIT = 1000
"""If more elements than this are missing on either side, elements are matched by position alone."""


class Span(NamedTuple):
    """A part of sequence A and a part of sequence B that correspond."""

    a_from: int
    a_to: int
    b_from: int
    b_to: int
    is_equal: bool


def align(a: Sequence[Hashable], b: Sequence[Hashable]) -> Iterator[Span]:
    """Yield spans that cover A and B from start to end: equal spans, and the spans between them."""
    blocks = _equal_blocks(a, b) or _equal_places(a, b)
    at_a = at_b = 0
    for a_from, b_from, length in [*blocks, (len(a), len(b), 0)]:
        if a_from > at_a or b_from > at_b:
            yield Span(at_a, a_from, at_b, b_from, is_equal=False)
        at_a, at_b = a_from + length, b_from + length
        if length:
            yield Span(a_from, at_a, b_from, at_b, is_equal=True)


def _equal_places(a: Sequence[Hashable], b: Sequence[Hashable]) -> list[tuple[int, int, int]]:
    return [(at, at, 1) for at, pair in enumerate(zip(a, b, strict=False)) if pair[0] == pair[1]]


def _equal_blocks(a: Sequence[Hashable], b: Sequence[Hashable]) -> list[tuple[int, int, int]] | None:
    """Return start in A, start in B and length of each equal block; None if too little is equal."""
    reached = {1: 0}
    """For each diagonal (position in A minus position in B), the farthest position reached in A."""
    steps: list[dict[int, int]] = []
    for edits in range(EDIT_LIMIT + 1):
        steps.append(reached.copy())
        for diagonal in range(-edits, edits + 1, 2):
            at_a = _entry(reached, edits, diagonal)[1]
            at_b = at_a - diagonal
            while at_a < len(a) and at_b < len(b) and a[at_a] == b[at_b]:
                at_a, at_b = at_a + 1, at_b + 1
            reached[diagonal] = at_a
            if at_a >= len(a) and at_b >= len(b):
                return _way_back(steps, len(a), len(b))
    return None


def _entry(reached: dict[int, int], edits: int, diagonal: int) -> tuple[int, int]:
    """Return the diagonal from which one more edit enters the given one, and the position in A."""
    if diagonal == -edits or (diagonal != edits and reached[diagonal - 1] < reached[diagonal + 1]):
        return diagonal + 1, reached[diagonal + 1]
    return diagonal - 1, reached[diagonal - 1] + 1


def _way_back(steps: list[dict[int, int]], at_a: int, at_b: int) -> list[tuple[int, int, int]]:
    blocks = []
    for edits in range(len(steps) - 1, -1, -1):
        came_from, entered = _entry(steps[edits], edits, at_a - at_b)
        length = at_a - entered
        if length > 0:
            blocks.append((entered, at_b - length, length))
        at_a = steps[edits][came_from]
        at_b = at_a - came_from
    return blocks[::-1]
