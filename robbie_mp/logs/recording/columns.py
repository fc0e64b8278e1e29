"""The messages of a channel as numpy columns, one for each number or text in them."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from robbie_mp.messages import Message
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers, Primitive, Text
from robbie_mp.messages.message import fields_of, nested

Columns = dict[str, np.ndarray[Any, Any]]
LENGTHS = ".lengths"


def columns(message_type: type[Message], messages: Iterable[Message]) -> Columns:
    """Return the fields of N messages by dotted names, such as `header.stamp.sec` and `ranges`.

    A number or text becomes an array of N; an array of fixed length L becomes (N, L). An array of variable
    length becomes one column with all elements of all messages, one after the other, and their lengths in
    `NAME.lengths`. Lists of texts and of messages do the same, the latter with a column for each field:
    `transforms.child_frame_id`. `numpy.split(ranges, numpy.cumsum(lengths)[:-1])` separates them again.
    """
    found: Columns = {}
    _add(found, nested(message_type), list(messages), "")
    return found


def _add(found: Columns, kind: FieldType, values: list[Any], name: str) -> None:
    match kind:
        case Nested():
            for field in fields_of(kind.message):
                inner = f"{name}.{field.schema_name}" if name else field.schema_name
                _add(found, field.type, [getattr(value, field.name) for value in values], inner)
        case Primitive():
            found[name] = np.array(values, kind.dtype)
        case Text():
            found[name] = np.array(values, np.str_)
        case Numbers(length=int(length)):
            found[name] = np.array(values, kind.element.dtype).reshape(len(values), length)
        case Numbers():
            found[name] = np.concatenate([np.empty(0, kind.element.dtype), *values])
            found[name + LENGTHS] = np.array([len(value) for value in values], np.int64)
        case Items():
            _add(found, kind.element, [item for value in values for item in value], name)
            found[name + LENGTHS] = np.array([len(value) for value in values], np.int64)
