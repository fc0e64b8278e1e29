"""The `repr` of messages."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

SHOWN = 6
"""Number of elements shown of an array or list; of longer ones, the first few and the last."""


def represent(class_name: str, fields: Iterable[tuple[str, Any]]) -> str:
    """Return a message on one line, long arrays and lists abbreviated."""
    return f"{class_name}({', '.join(f'{name}={_value(value)}' for name, value in fields)})"


def _value(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return (
            f"<{len(value)} {value.dtype}: {_elements(value, str)}>" if len(value) else f"<0 {value.dtype}>"
        )
    if isinstance(value, list):
        return f"[{_elements(value, repr)}]"
    return repr(value)


def _elements(values: Any, show: Any) -> str:
    if len(values) <= SHOWN:
        return ", ".join(map(show, values))
    first = ", ".join(map(show, values[: SHOWN - 1]))
    return f"{first}, … {len(values) - SHOWN} more …, {show(values[-1])}"
