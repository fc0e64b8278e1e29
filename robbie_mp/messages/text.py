"""How messages show themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from robbie_mp.messages.field_types import fields_of

if TYPE_CHECKING:
    from robbie_mp.messages.message import Message

SHOWN = 6
"""Elements of an array or list that are shown; of longer ones the first few and the last."""


def represent(message: Message) -> str:
    """Return the message on one line, long arrays and lists abbreviated."""
    parts = (f"{field.name}={_value(getattr(message, field.name))}" for field in fields_of(type(message)))
    return f"{type(message).__name__}({', '.join(parts)})"


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
