"""Writes the constants that C shares with Python: `python -m tools.layout_header`."""

import argparse
from collections.abc import Iterable, Iterator
from enum import IntEnum
from pathlib import Path
from types import ModuleType

from robbie_mp.bus.core import directory, ledger, router
from robbie_mp.bus.transport import allocator, blocks, histogram, history, layout, records, tables, words
from robbie_mp.module import outbox, pins

HEADER = Path(__file__).parents[1] / "robbie_mp" / "bus" / "_hot" / "layout.h"
WHOLE = (layout, records, words)
SINGLE = {
    tables: ("ROW_OPEN", "ROW_CLOSED", "Outcome"),
    allocator: ("BLOCK_ALIGNMENT",),
    blocks: ("LEAD_BYTES",),
    histogram: ("SUM_NS", "MAX_NS", "BUCKETS", "UNIT_BITS", "PARTS_BITS", "MAX_TIME_NS"),
    history: ("Event",),
    ledger: ("NO_RECORD",),
    router: ("RECORDS_PER_TURN", "IN_FLIGHT_SHARE"),
    directory: ("MAX_INTERVAL_US",),
    outbox: ("MAX_IN_FLIGHT", "MAX_READY_BLOCK_BYTES"),
    pins: ("MAX_PINNED", "PINNED_SHARE"),
}
MAX_INT = (1 << 31) - 1
"""A constant of an enum in C is an int."""
TEXT = """\
/* Constants that C shares with Python, each under its name there: the layout of shared memory, the records,
 * and what the steps of the hot path use besides. Those of an enum are called NAME_MEMBER.
 * Written by `python -m tools.layout_header`: do not edit. */
#ifndef ROBBIE_LAYOUT_H
#define ROBBIE_LAYOUT_H

#include <stdint.h>

enum {{
{small}
}};

{large}

#endif
"""


def header() -> str:
    """Return the text of the header."""
    found: dict[str, int] = {}
    for module in WHOLE:
        found |= constants(module, vars(module))
    for module, names in SINGLE.items():
        found |= constants(module, names)
    small = "\n".join(f"    {name} = {value}," for name, value in found.items() if value <= MAX_INT)
    large = "\n".join(
        f"#define {name} UINT64_C({value:#x})" for name, value in found.items() if value > MAX_INT
    )
    return TEXT.format(small=small, large=large)


def constants(module: ModuleType, names: Iterable[str]) -> Iterator[tuple[str, int]]:
    """Return the whole numbers among these names of a module, and the members of its enums."""
    for name in names:
        value = getattr(module, name)
        if isinstance(value, type) and issubclass(value, IntEnum) and value.__module__ == module.__name__:
            yield from ((f"{_upper(name)}_{key}", int(member)) for key, member in value.__members__.items())
        elif isinstance(value, int) and name.isupper() and not name.startswith("_"):
            yield name, value


def _upper(name: str) -> str:
    """Turn a class's name into that of a constant: SegmentKind, SEGMENT_KIND."""
    return "".join(f"_{letter}" if letter.isupper() else letter.upper() for letter in name).lstrip("_")


if __name__ == "__main__":
    argparse.ArgumentParser(prog="python -m tools.layout_header", description=__doc__).parse_args()
    HEADER.write_text(header())
