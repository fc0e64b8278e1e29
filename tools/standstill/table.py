"""The cells, and the table of them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tools.standstill.judgement import TrueMotion

PARTS = {
    "operator's program": ("hand", "laptop's pilot", "browser", "node", "client"),
    "bridge": ("link", "operator", "ros1", "foxglove"),
    "driver": ("navigation", "exploration", "parcours"),
}
"""What processes of several ways do; the table has one row for them."""
PART_OF = {role: part for part, roles in PARTS.items() for role in roles}


@dataclass(frozen=True)
class Cell:
    """One failure on one way, once.

    Attributes:
        way: how the robot was driven.
        failure: what failed.
        motion: what the robot did; None: it was not tried.
        trouble: why not.
        load: processes that waited for a processor (the load average of a minute).
        limit_s: within which it must stand.
    """

    way: str
    failure: str
    motion: TrueMotion | None
    trouble: str
    load: float
    limit_s: float

    @property
    def row(self) -> str:
        """Its row in the table."""
        role, _, what = self.failure.rpartition(" ")
        return f"{PART_OF.get(role, role)} {what}"

    @property
    def keeps(self) -> bool:
        """Whether it was tried, and the robot stood in time."""
        return self.motion is not None and self.motion.keeps(self.limit_s)

    @property
    def text(self) -> str:
        """What the robot did, in few words: until it stood, and the way driven blind."""
        if self.motion is None:
            return "not tried"
        motion = self.motion
        if math.isnan(motion.stands_s):
            return "**unknown**"
        if motion.fresh_s < motion.stands_s:
            told = f"back {motion.fresh_s:.2f} s, {motion.blind_m:.2f} m"
        elif math.isinf(motion.stands_s):
            told = f"does not stand, {motion.driven_m:.2f} m"
        else:
            told = f"{motion.stands_s:.2f} s, {min(motion.driven_m, motion.blind_m):.2f} m"
            if motion.resumed_s < motion.fresh_s - 0.05:
                told += f", again {motion.resumed_s:.2f} s"
        return told if self.keeps else f"**{told}**"


def worst(cells: Sequence[Cell]) -> Cell:
    """Return the cell that is farthest from its limit among several rounds."""

    def badness(cell: Cell) -> tuple[bool, float]:
        motion = cell.motion
        return (
            motion is not None and not cell.keeps,
            min(motion.stands_s, motion.fresh_s) if motion else -1.0,
        )

    return max(cells, key=badness)


def table(cells: Sequence[Cell]) -> str:
    """Return the table in Markdown: a row for each failure, a column for each way, the worst round."""
    ways = list(dict.fromkeys(cell.way for cell in cells))
    rows = list(dict.fromkeys(cell.row for cell in cells))
    lines = [f"| failure | {' | '.join(ways)} |", f"|---|{'---|' * len(ways)}"]
    for row in rows:
        found = [[one for one in cells if (one.way, one.row) == (way, row)] for way in ways]
        lines.append(f"| {row} | {' | '.join(worst(some).text if some else '' for some in found)} |")
    return "\n".join(lines)


def summary(cells: Sequence[Cell]) -> str:
    """Return how many cells were tried, and which did not keep the limit."""
    grouped: dict[tuple[str, str], list[Cell]] = {}
    for cell in cells:
        grouped.setdefault((cell.way, cell.failure), []).append(cell)
    tried = [some for some in grouped.values() if any(one.motion for one in some)]
    bad = [worst(some) for some in tried if not worst(some).keeps]
    loads = [cell.load for cell in cells]
    measured = sum(cell.motion is not None for cell in cells)
    lines = [
        f"{len(tried)} of {len(grouped)} cells tried, {measured} measurements, {len(bad)} cells late; "
        f"load {min(loads):.0f} to {max(loads):.0f}"
    ]
    lines += [f"late: {cell.way}: {cell.failure}: {cell.text}" for cell in bad]
    lines += [
        f"not tried: {way}: {name}: {some[0].trouble}"
        for (way, name), some in grouped.items()
        if some not in tried
    ]
    return "\n".join(lines)
