"""What we encode, rosbags and mcap-ros2-support decode; what rosbags encodes, we decode: bit for bit."""

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic

from robbie_mp.messages import Message, message_type_from_schema, schema_text, stock_registry
from tests.messages._support.rosbags_bridge import (
    assert_same,
    jazzy,
    name_for_rosbags,
    store_with,
    to_rosbags,
)
from tests.messages._support.strategies import PATIENT, definitions, messages

pytestmark = pytest.mark.slow

STOCK = list(stock_registry())
JAZZY = jazzy()
# ROS itself has neither our own types nor those of Foxglove.
NOT_IN_ROS = [each for each in STOCK if each.type_name.startswith(("robbie_msgs/", "foxglove_msgs/"))]
for other in NOT_IN_ROS:
    JAZZY.register(store_with(other.type_name, schema_text(other)).fielddefs)
# Shrinking takes minutes here; the schema and the message that failed are shown anyway.
GENERATE_ONLY = [Phase.explicit, Phase.reuse, Phase.generate]


def stock(of: list[type[Message]]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("message_type", of, ids=lambda each: each.type_name)


@stock([each for each in STOCK if each not in NOT_IN_ROS])
def test_a_stock_type_has_the_fields_of_ros_in_their_order(message_type: type[Message]) -> None:
    ours = store_with(message_type.type_name, schema_text(message_type)).fielddefs[message_type.type_name]
    theirs = JAZZY.fielddefs[message_type.type_name]
    assert [field[:2] for field in ours[1]] == [field[:2] for field in theirs[1]]
    assert {(name, value) for name, _, value in ours[0]} == {(name, value) for name, _, value in theirs[0]}


@stock(STOCK)
@given(data=st.data())
@settings(PATIENT, max_examples=8, phases=GENERATE_ONLY)
def test_a_stock_message_is_the_same_for_all_three(message_type: type[Message], data: st.DataObject) -> None:
    name = name_for_rosbags(message_type.type_name)
    message = data.draw(messages(message_type))
    encoded = bytes(JAZZY.serialize_cdr(to_rosbags(JAZZY, message), name))
    assert message.encode() == encoded
    assert_same(message_type.decode(encoded), JAZZY.deserialize_cdr(encoded, name))
    assert_same(message, generate_dynamic(name, schema_text(message_type))[name](encoded))


@given(schema=definitions(), data=st.data())
@settings(PATIENT, max_examples=40, phases=GENERATE_ONLY)
def test_any_type_is_the_same_bytes_for_rosbags(schema: str, data: st.DataObject) -> None:
    message_type = message_type_from_schema("random_msgs/msg/Main", schema)
    store = store_with(message_type.type_name, schema)
    message = data.draw(messages(message_type))
    encoded = bytes(store.serialize_cdr(to_rosbags(store, message), message_type.type_name))
    assert message.encode() == encoded
    assert message.encoded_size() == len(encoded)
    assert message_type.decode(encoded).encode() == encoded
    assert_same(message_type.decode(encoded), store.deserialize_cdr(encoded, message_type.type_name))
