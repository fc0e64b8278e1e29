"""Types as text, for programs that cannot import them."""

from typing import Any

import numpy as np
import pytest

from robbie_mp.messages import Array, LaserScan, Message, Time, UnknownType, float32, schema_text
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription, own_types


class Whisker(Message, name="mouse/msg/Whisker", version=3):
    """What a whisker feels."""

    stamp: Time
    angles: Array[float32]  # rad
    name: str = "left"


KNOWN = KnownTypes([TypeDescription.of(Whisker)])


def test_own_types_are_described_and_stock_types_are_not() -> None:
    described = {one.name: one for one in own_types()}
    assert described["mouse/msg/Whisker"] == TypeDescription(
        "mouse/msg/Whisker", 3, schema_text(Whisker), __name__
    )
    assert "sensor_msgs/msg/LaserScan" not in described


def test_class_made_of_a_description_reads_the_same_bytes() -> None:
    sent = Whisker(stamp=Time(sec=3), angles=np.array([0.5, 1.0]), name="right")
    got: Any = KNOWN.get("Whisker").decode(sent.encode())
    assert got.angles.tolist() == [0.5, 1.0]
    assert (got.stamp.sec, got.name, got.version) == (3, "right", 3)


@pytest.mark.parametrize(
    "name", ["sensor_msgs/msg/LaserScan", "sensor_msgs/LaserScan", "LaserScan", "laserscan"]
)
def test_type_is_found_by_full_short_and_last_name(name: str) -> None:
    assert KNOWN.get(name) is LaserScan


def test_unknown_type_is_refused_with_what_was_meant() -> None:
    with pytest.raises(UnknownType, match="did you mean 'mouse/msg/Whisker'"):
        KNOWN.get("mouse/Wisker")
    with pytest.raises(UnknownType, match="did you mean 'sensor_msgs/msg/LaserScan'"):
        KNOWN.get("nav_msgs/LaserScan")


def test_name_that_two_types_end_with_must_say_which() -> None:
    known = KnownTypes([TypeDescription("my/msg/LaserScan", 1, "int32 x\n")])
    with pytest.raises(UnknownType, match=r"my/msg/LaserScan.* or .*sensor_msgs"):
        known.get("LaserScan")
    assert known.get("my/LaserScan").type_name == "my/msg/LaserScan"
