"""Messages with one damaged field each, to find programs that die of them."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from robbie_mp.messages import (
    CameraInfo,
    Costmap,
    CostmapMetaData,
    Header,
    Image,
    JointState,
    LaserScan,
    MapMetaData,
    Message,
    MessageError,
    OccupancyGrid,
    Point,
    Pose,
    Time,
    replace,
)
from robbie_mp.messages.field_types import Field, Items, Nested, Numbers, Primitive, Text
from robbie_mp.messages.message import fields_of

AT = Header(stamp=Time(sec=1), frame_id="map")
FLOATS = (math.nan, math.inf, -math.inf, 3e38, 9e6, -1.0, 0.0)
TEXTS = ("", "\u202e\U0001f916\t", "x" * 5000, "map", "NaN")


def plausible(message_type: type[Message]) -> Message:
    """Return a message of a type as a robot would send it, or the default one."""
    corner = Pose(position=Point(x=-1.0, y=-1.0))
    known: dict[type[Message], dict[str, Any]] = {
        LaserScan: {
            "angle_min": -1.5, "angle_max": 1.5, "angle_increment": 0.05, "range_min": 0.05,
            "range_max": 8.0, "ranges": np.full(61, 2.0, np.float32),
        },
        OccupancyGrid: {
            "info": MapMetaData(resolution=0.05, width=40, height=40, origin=corner),
            "data": np.zeros(1600, np.int8),
        },
        Costmap: {
            "metadata": CostmapMetaData(resolution=0.05, size_x=40, size_y=40, origin=corner),
            "data": np.zeros(1600, np.uint8),
        },
        Image: {
            "width": 64, "height": 48, "step": 192, "encoding": "rgb8", "data": np.zeros(9216, np.uint8),
        },
        CameraInfo: {
            "width": 64, "height": 48, "k": np.array([50.0, 0, 32, 0, 50, 24, 0, 0, 1]),
        },
        JointState: {"name": ["pan"], "position": np.zeros(1)},
    }  # fmt: skip
    fields = dict(known.get(message_type, {}))
    if any(field.name == "header" for field in fields_of(message_type)):
        fields["header"] = AT
    return message_type(**fields)


def damaged(message: Message) -> Iterator[tuple[str, Message]]:
    """Return the message once for each damage, with the field and what is wrong with it."""
    for field in fields_of(type(message)):
        for what, value in _damages(field, getattr(message, field.name)):
            try:
                yield f"{field.name}{what}", replace(message, **{field.name: value})
            except MessageError:
                continue


def _damages(field: Field, value: Any) -> Iterator[tuple[str, Any]]:
    kind = field.type
    if isinstance(kind, Nested):
        for path, one in damaged(value):
            yield f".{path}", one
    elif isinstance(kind, Numbers):
        yield from _wrong_arrays(kind, value)
    elif isinstance(kind, Items):
        yield " empty", []
        items = list(value) or [kind.element.message() if isinstance(kind.element, Nested) else "a"]
        yield " doubled", items + items
        if isinstance(kind.element, Nested):
            for path, one in damaged(items[0]):
                yield f"[0].{path}", [one, *items[1:]]
        else:
            yield from ((f"[0]={text[:8]!r}", [text, *items[1:]]) for text in TEXTS)
    else:
        yield from ((f"={one!r:.12}", one) for one in _wrong_values(kind) if one != value)


def _wrong_values(kind: Primitive | Text) -> tuple[Any, ...]:
    if isinstance(kind, Text):
        return TEXTS
    if kind.name == "bool":
        return (False, True)
    if kind.code in "fd":
        return FLOATS
    limits = np.iinfo(kind.dtype)
    return (int(limits.min), int(limits.max), 0, 1)


def _wrong_arrays(kind: Numbers, value: Any) -> Iterator[tuple[str, Any]]:
    yield " empty", value[:0]
    yield " shorter", value[:-1]
    yield " longer", np.append(value, value[:1] if len(value) else np.zeros(1, value.dtype))
    full = value if len(value) else np.zeros(kind.length or 3, value.dtype)
    for one in _wrong_values(kind.element):
        first = full.copy()
        first[0] = one
        yield f"[0]={one!r:.12}", first
        yield f"[:]={one!r:.12}", np.full_like(full, one)
