"""Types are found by name."""

import pytest

from robbie_mp.messages import (
    DuplicateType,
    Header,
    LaserScan,
    Odometry,
    Pose,
    TypeRegistry,
    UnknownType,
    message_type_from_schema,
    stock_registry,
)


def test_a_type_is_found_by_its_full_and_its_short_name() -> None:
    registry = TypeRegistry([LaserScan])
    assert registry.get("sensor_msgs/msg/LaserScan") is registry.get("sensor_msgs/LaserScan") is LaserScan
    assert "sensor_msgs/LaserScan" in registry and "sensor_msgs/msg/Image" not in registry


def test_nested_types_come_with_a_type() -> None:
    registry = TypeRegistry([Odometry])
    assert registry.get("geometry_msgs/msg/Pose") is Pose
    assert len(registry) == len(list(registry)) == 10


@pytest.mark.parametrize(
    "name", ["sensor_msgs/msg/LaserScn", "LaserScan", "laserscan", "sensors_msgs/LaserScan"]
)
def test_an_unknown_name_is_answered_with_near_ones(name: str) -> None:
    with pytest.raises(UnknownType, match="did you mean 'sensor_msgs/msg/LaserScan'") as caught:
        stock_registry().get(name)
    assert repr(name) in str(caught.value)
    assert isinstance(caught.value, LookupError)


def test_a_name_belongs_to_one_type() -> None:
    registry = TypeRegistry([Header])
    registry.add(Header)
    registry.add(
        message_type_from_schema("std_msgs/msg/Header", "builtin_interfaces/Time stamp\nstring frame_id")
    )
    assert registry.get("std_msgs/msg/Header") is Header
    with pytest.raises(DuplicateType, match=r"std_msgs/msg/Header: .* is not .*Header"):
        registry.add(message_type_from_schema("std_msgs/msg/Header", "uint32 seq\nstring frame_id"))


def test_registries_are_independent() -> None:
    registry = stock_registry()
    registry.add(message_type_from_schema("my_msgs/msg/Mine", "uint8 x"))
    assert "my_msgs/msg/Mine" not in stock_registry()
