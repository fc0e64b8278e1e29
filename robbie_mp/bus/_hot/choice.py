"""Chooses the form of the hot path: the module written in C, or the Python that it follows.

Only the places where processes are put together ask. They pass the answer on as an argument.
"""

import os
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from robbie_mp.base.version import LAYOUT_VERSION
from robbie_mp.bus._hot.sources import digest

if TYPE_CHECKING:
    from robbie_mp.bus._hot import native as written_in_c

PURE_PYTHON = "ROBBIE_PURE_PYTHON"
"""The variable that chooses Python: any value except the empty one and 0."""

_HERE = Path(__file__).parent
_BUILD_AGAIN = "install Robbie-MP again with pip, or run make in a checkout"


class Native(Protocol):
    """The module written in C.

    A class of `native.pyi` is an attribute here, such as `RingWriter: "type[written_in_c.RingWriter]"`.
    """

    LAYOUT_VERSION: int
    SOURCES: str
    Wakeup: "type[written_in_c.Wakeup]"
    MessageCodec: "type[written_in_c.MessageCodec]"
    RingWriter: "type[written_in_c.RingWriter]"
    RingReader: "type[written_in_c.RingReader]"
    NumberRingWriter: "type[written_in_c.NumberRingWriter]"
    NumberRingReader: "type[written_in_c.NumberRingReader]"
    Lock: "type[written_in_c.Lock]"
    Endpoint: "type[written_in_c.Endpoint]"
    Block: "type[written_in_c.Block]"
    KeptBlocks: "type[written_in_c.KeptBlocks]"
    Publisher: "type[written_in_c.Publisher]"
    FreeRows: "type[written_in_c.FreeRows]"
    Books: "type[written_in_c.Books]"
    MappedSegment: "type[written_in_c.MappedSegment]"
    Unreferenced: "type[written_in_c.Unreferenced]"
    Pins: "type[written_in_c.Pins]"
    Subscriber: "type[written_in_c.Subscriber]"
    History: "type[written_in_c.History]"
    TickTimes: "type[written_in_c.TickTimes]"
    Loop: "type[written_in_c.Loop]"


def native() -> Native | None:
    """Return the module written in C; None if Python does the hot path, see `why_not`."""
    return _choose()[0]


def why_not() -> str:
    """Say why Python does the hot path, and after a semicolon what to do; '' if C does it."""
    return _choose()[1]


def _choose() -> tuple[Native | None, str]:
    if os.environ.get(PURE_PYTHON, "") not in ("", "0"):
        return None, f"{PURE_PYTHON}={os.environ[PURE_PYTHON]} is set; unset it to use C"
    if "t" in sys.abiflags:
        return None, "this Python has no global interpreter lock, on which the C code relies; use another"
    try:
        from robbie_mp.bus._hot import native as module  # noqa: PLC0415 (not where it must not be loaded)
    except ImportError as error:
        return None, _why_missing(error, _HERE)
    reason = _why_unsuitable(module, _HERE)
    return (None, reason) if reason else (module, "")


def _why_missing(error: ImportError, folder: Path) -> str:
    """Say why the module cannot be imported.

    Args:
        error: what the import raised.
        folder: where the module should be.
    """
    built = [path.name for path in folder.glob("native.*.so")]
    if not built:
        return (
            "it was not built: there was no working C compiler, or no Cython, when Robbie-MP was installed; "
            f"install gcc and the headers of Python (apt-get install gcc python3-dev), then {_BUILD_AGAIN}"
        )
    if not any(name == f"native{suffix}" for name in built for suffix in EXTENSION_SUFFIXES):
        return f"it was built for another Python ({', '.join(sorted(built))}); {_BUILD_AGAIN}"
    return f"it cannot be loaded ({error}); {_BUILD_AGAIN}"


def _why_unsuitable(module: Native, folder: Path) -> str:
    """Say why a module that was imported must not be used; '' if it may.

    Args:
        module: the module.
        folder: where its sources lie if this is a checkout.
    """
    layout = getattr(module, "LAYOUT_VERSION", None)
    if layout != LAYOUT_VERSION:
        return (
            f"it was built for version {layout} of the memory's layout, not {LAYOUT_VERSION}; {_BUILD_AGAIN}"
        )
    sources = digest(folder)
    if sources and sources != module.SOURCES:
        return f"it was built from other sources than those beside it; {_BUILD_AGAIN}"
    return ""
