"""Random messages of any type, and random types."""

from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from robbie_mp.messages import Message
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers, Primitive, Text
from robbie_mp.messages.message import fields_of
from robbie_mp.messages.primitives import PRIMITIVES

MAX_ELEMENTS = 20
PATIENT = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
"""A busy machine is no failure."""


def primitives(kind: Primitive) -> st.SearchStrategy[Any]:
    if kind.name == "bool":
        return st.booleans()
    if kind.code in "fd":
        return st.floats(width=32 if kind.code == "f" else 64)
    limits = np.iinfo(kind.dtype)
    return st.integers(int(limits.min), int(limits.max))


def texts(kind: Text) -> st.SearchStrategy[str]:
    characters = st.characters(exclude_categories=["Cs"], exclude_characters="\0")
    # A character has up to four bytes, the bound counts bytes.
    return st.text(characters, max_size=MAX_ELEMENTS if kind.max_length is None else kind.max_length // 4)


def values(kind: FieldType) -> st.SearchStrategy[Any]:
    match kind:
        case Primitive():
            return primitives(kind)
        case Text():
            return texts(kind)
        case Nested():
            return messages(kind.message)
        case Numbers():
            return counts(kind).flatmap(
                lambda n: npst.arrays(kind.element.dtype, n, elements=primitives(kind.element))
            )
        case Items():
            return counts(kind, 4).flatmap(lambda n: st.lists(values(kind.element), min_size=n, max_size=n))


def counts(kind: Numbers | Items, most: int = MAX_ELEMENTS) -> st.SearchStrategy[int]:
    if kind.length is not None:
        return st.just(kind.length)
    return st.integers(0, most if kind.max_length is None else min(most, kind.max_length))


def messages(message_type: type[Message]) -> st.SearchStrategy[Any]:
    return st.builds(message_type, **{field.name: values(field.type) for field in fields_of(message_type)})


# Not byte: rosbags takes it for signed, ROS 2 has it as an octet.
PRIMITIVE_NAMES = [each for each in PRIMITIVES if each != "byte"]


@st.composite
def definitions(draw: st.DrawFn) -> str:
    """A ros2msg text: a type with up to two nested ones, one of which may be in the other."""
    names = ["Main", "Inner", "Innermost"][: draw(st.integers(1, 3))]
    parts = []
    for index, name in enumerate(names):
        usable = (
            PRIMITIVE_NAMES + ["string"] * 4 + [f"random_msgs/{inner}" for inner in names[index + 1 :]] * 6
        )
        head = "" if index == 0 else f"{'=' * 80}\nMSG: random_msgs/{name}\n"
        types = draw(
            st.lists(
                st.tuples(st.sampled_from(usable), st.sampled_from(["", "", "", "[]", "[3]"])),
                min_size=1,
                max_size=7,
            )
        )
        parts.append(
            head + "".join(f"{kind}{several} field_{i}\n" for i, (kind, several) in enumerate(types))
        )
    return "".join(parts)
