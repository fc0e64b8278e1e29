"""Who still refers to the memory of a loan at its end, and whether they can still change the message.

The obvious code gives an array a name in a function, and the name outlives the `with` block:

    with self.loan(Image, …, data=height * width) as image:
        pixels = image.data.reshape(height, width)
        pixels[:] = 20

Such arrays are made read-only, so that the message can be passed on as it is. Whatever else refers to the
memory, such as a tensor or a `memoryview`, cannot be made read-only: then the message must be copied.

numpy takes a hold of its own on a buffer, so `memoryview.release()` succeeds although arrays over it live.
Counting references is the only way to see them.
"""

import inspect
import logging
import sys
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from types import FrameType
from typing import Any

import numpy as np

from robbie_mp.messages.loans import Layout

_PROBE: dict[int, object] = {0: object()}
_OWN_REFERENCES = sys.getrefcount(_PROBE[0])
"""References counted for an object that only a dict holds: the number depends on the interpreter."""
_LOCALS_ARE_COPIED = sys.version_info < (3, 13)
"""Whether `frame.f_locals` is a dict that the frame keeps, with references of its own (before PEP 667)."""

_MAX_FRAMES = 8
"""The function with the block is among so many: the others end the loan. Looking into more has a cost, as a
frame that keeps its locals keeps them alive."""


class CopiedLoans:
    """Counts loans that had to be copied, and warns of the 1st, 2nd, 4th, 8th, …: loud, but bounded.

    Args:
        log: gets the warnings.

    Attributes:
        count: how many there were.
    """

    def __init__(self, log: logging.Logger):
        self._log = log
        self.count = 0

    def add(self, type_name: str) -> None:
        """Count the copy of a message of a type."""
        self.count += 1
        if self.count & (self.count - 1) == 0:
            self._log.warning(
                "the array of a loaned %s is kept beyond its with block, so the message was copied (%d in "
                "all). Keep a copy instead of the array, as in `self.last = image.data.copy()`",
                type_name,
                self.count,
            )


def freeze_named_arrays(whole: "np.ndarray[Any, Any]", layout: Layout[Any]) -> bool:
    """Make the arrays in the memory of a loan read-only, if only names in the function refer to them.

    Args:
        whole: the memory of the loan; the caller has let go of all arrays in it.
        layout: of the message.

    Returns:
        Whether nobody can write into the memory any more.
    """
    names: Counter[int] = Counter()
    objects: dict[int, Any] = {}
    _find_named(whole, names, objects)
    _add_bases(names, objects)
    roots = [key for key, one in objects.items() if not isinstance(one, np.ndarray)]
    if len(roots) != 1 or (isinstance(objects[roots[0]], memoryview) and len(layout.loaned) > 1):
        return False  # what lends in Python makes a root for each array, so others may be held unseen
    if any(sys.getrefcount(objects[key]) - _OWN_REFERENCES > names[key] for key in objects):
        return False
    for key in objects.keys() - roots:
        objects[key].flags.writeable = False
    return True


def _find_named(whole: "np.ndarray[Any, Any]", names: Counter[int], objects: dict[int, Any]) -> None:
    """Find the arrays in the memory that have names in the function of the block, and count the names."""
    start = whole.__array_interface__["data"][0]
    for frame in islice(_callers(), _MAX_FRAMES):
        is_copied = _LOCALS_ARE_COPIED and frame.f_code.co_flags & inspect.CO_OPTIMIZED
        for value in frame.f_locals.values():
            if type(value) is not np.ndarray or value is whole:
                continue
            if 0 <= value.__array_interface__["data"][0] - start < whole.nbytes:
                objects[id(value)] = value
                names[id(value)] += 2 if is_copied else 1
        if objects:
            return


def _callers() -> Iterator[FrameType]:
    """Yield the frames outside this file."""
    frame: FrameType | None = sys._getframe()
    while frame is not None:
        if frame.f_code.co_filename != __file__:
            yield frame
        frame = frame.f_back


def _add_bases(names: Counter[int], objects: dict[int, Any]) -> None:
    """Add what the arrays are views of, and count the references by their views."""
    waiting = list(objects.values())
    while waiting:
        array = waiting.pop()
        base = array.base
        names[id(base)] += 1
        if id(base) not in objects:
            objects[id(base)] = base
            if isinstance(base, np.ndarray):
                waiting.append(base)
