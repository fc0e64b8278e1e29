"""Every message type of every distribution of ROS that rosbags knows is read, and encoded as rosbags does."""

import random
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from robbie_mp.messages import Message, message_type_from_schema, schema_text
from robbie_mp.messages.field_types import FieldType, Items, Nested, Numbers, Primitive, Text
from robbie_mp.messages.message import fields_of
from tests.messages._support.rosbags_bridge import assert_same, to_rosbags

STORES = [one for one in Stores if one.value.startswith(("ros1_", "ros2_"))]
ROUNDS = 3


def random_number(chance: random.Random, kind: Primitive) -> bool | int | float:
    if kind.name == "bool":
        return chance.random() < 0.5
    if kind.code in "fd":
        number = chance.choice([0.0, -1.5, 1e30, float("inf"), chance.uniform(-1, 1)])
        return float(np.float32(number)) if kind.code == "f" else number
    # An octet in ROS 2; rosbags takes `byte` for signed, as ROS 1 does.
    limits = np.iinfo(np.int8 if kind.name == "byte" else kind.dtype)
    if kind.name == "byte":
        return chance.randint(0, int(limits.max))
    return chance.choice([int(limits.min), int(limits.max), chance.randint(int(limits.min), int(limits.max))])


def random_value(chance: random.Random, kind: FieldType) -> Any:
    match kind:
        case Primitive():
            return random_number(chance, kind)
        case Text(max_length=limit):
            return "".join(chance.choices("abc äß€", k=chance.randint(0, 9)))[: (limit or 99) // 3]
        case Nested():
            return random_message(chance, kind.message)
        case Numbers(element=element):
            values = [random_number(chance, element) for _ in range(random_count(chance, kind))]
            return np.array(values, element.dtype)
        case Items():
            return [random_value(chance, kind.element) for _ in range(random_count(chance, kind))]


def random_count(chance: random.Random, kind: Numbers | Items) -> int:
    return chance.randint(0, min(kind.max_length or 4, 4)) if kind.length is None else kind.length


def random_message(chance: random.Random, message_type: type[Message]) -> Message:
    return message_type(**{field.name: random_value(chance, field.type) for field in fields_of(message_type)})


def constants(store: Typestore, name: str) -> dict[str, Any]:
    return {constant: value for constant, _, value in store.fielddefs[name][0]}


@pytest.mark.slow
@pytest.mark.parametrize("distribution", STORES, ids=lambda one: one.value)
def test_every_type_is_understood_and_encoded_alike(distribution: Stores) -> None:
    store = get_typestore(distribution)
    chance = random.Random(1)
    assert len(store.fielddefs) > 100
    for name in store.fielddefs:
        text, _ = store.generate_msgdef(name, ros_version=2)
        made = message_type_from_schema(name, text)
        again = message_type_from_schema(name, schema_text(made))
        for constant, value in constants(store, name).items():
            found = pytest.approx(value, rel=1e-6) if isinstance(value, float) else value  # some are float32
            assert (getattr(made, constant), getattr(again, constant)) == (found, found), (name, constant)
        for _ in range(ROUNDS):
            message = random_message(chance, made)
            encoded = bytes(store.serialize_cdr(to_rosbags(store, message), name))
            assert message.encode() == encoded, name
            assert_same(made.decode(encoded), store.deserialize_cdr(encoded, name))
            assert again.decode(encoded).encode() == encoded, name
