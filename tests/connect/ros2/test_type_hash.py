"""Type hashes beside those that ROS 2's own generator has published, and those of rosbags.

`published_type_hashes.json` holds hashes from sources that rosidl has generated for ROS 2 Kilted: micro-ROS
in github.com/hpmicro/hpm_sdk, 375f7cbc. That of `tf2_msgs/msg/TFMessage` is from
github.com/youtalk/swift-ros2, 2d68d36, which compares its hashes with rosidl's for Jazzy. The definitions are
those of Jazzy in rosbags, so a type that differs between Jazzy and Kilted would show.
"""

import json
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.messages.schema import schema_text
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.messages.stock.registry import stock_registry

PUBLISHED: dict[str, str] = json.loads(Path(__file__).with_name("published_type_hashes.json").read_text())
STOCK = {one.type_name: one for one in stock_registry()}


def test_stock_types_have_the_hashes_that_ros_has_published() -> None:
    both = PUBLISHED.keys() & STOCK.keys()
    assert len(both) >= 34
    assert {name: type_hash(STOCK[name]) for name in both} == {name: PUBLISHED[name] for name in both}


def test_types_of_jazzy_have_the_hashes_that_ros_has_published() -> None:
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    both = sorted(PUBLISHED.keys() & jazzy.types.keys())
    assert len(both) >= 150
    for name in both:
        text, _ = jazzy.generate_msgdef(name, ros_version=2)
        assert type_hash(message_type_from_schema(name, text)) == PUBLISHED[name], name


def test_rosbags_computes_the_same_hashes_of_all_stock_messages() -> None:
    store = get_typestore(Stores.EMPTY)
    messages = [one for one in STOCK.values() if "/msg/" in one.type_name]
    assert len(messages) >= 70
    for one in messages:
        store.register(get_types_from_msg(schema_text(one), one.type_name))
        assert type_hash(one) == store.hash_rihs01(one.type_name), one.type_name


def test_bounded_and_empty_types_are_described_as_ros_does() -> None:
    bounds = message_type_from_schema(
        "test_msgs/msg/Bounds", "string<=5[<=3] names\nint8[<=4] numbers\nbyte raw"
    )
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema_text(bounds), bounds.type_name))
    assert type_hash(bounds) == store.hash_rihs01(bounds.type_name)
    assert type_hash(message_type_from_schema("std_msgs/msg/Empty", "")) == PUBLISHED["std_msgs/msg/Empty"]
