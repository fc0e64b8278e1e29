"""A run knows one definition of each version of a message type, and its processes exchange no other."""

from pathlib import Path
from typing import Any, cast

import pytest

from robbie_mp import Header, Message, float64, uint8
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.cli.channel_choice import choose_channel
from robbie_mp.messages import LaserScan, UnknownType
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.messages.message import MessageType
from robbie_mp.run.declared_types import ChangedType, DeclaredTypes
from robbie_mp.run.learnt_types import learn_type, learnt_types


def pair(version: int = 1, **fields: Any) -> type[Message]:
    """Return a class of one name with these fields."""
    body = {"__annotations__": fields, "__module__": __name__, "__doc__": "A pair."}
    return cast(
        "type[Message]", MessageType("Pair", (Message,), body, name="team_msgs/msg/Pair", version=version)
    )


PAIR = pair(left=float64, right=float64)
CHANGED = {
    "swapped": (pair(right=float64, left=float64), "field 1 was `float64 left` and is `float64 right`"),
    "renamed": (pair(left=float64, width=float64), "field 2 was `float64 right` and is `float64 width`"),
    "retyped": (pair(left=float64, right=uint8), "field 2 was `float64 right` and is `uint8 right`"),
    "shorter": (pair(left=float64), "field 2 was `float64 right` and is none"),
    "longer": (pair(left=float64, right=float64, z=uint8), "field 3 was none and is `uint8 z`"),
}


@pytest.mark.parametrize("changed", CHANGED)
@pytest.mark.parametrize("is_planned", [True, False], ids=["planned", "learnt"])
def test_changed_class_is_refused_and_the_error_says_what_to_do(
    changed: str, is_planned: bool, tmp_path: Path
) -> None:
    planned = [TypeDescription.of(PAIR)] if is_planned else []
    DeclaredTypes(tmp_path, planned).declare(PAIR)
    other, said = CHANGED[changed]
    for check in (DeclaredTypes(tmp_path, planned).declare, DeclaredTypes(tmp_path, planned).check):
        with pytest.raises(ChangedType) as refused:
            check(other)
        assert f"team_msgs/msg/Pair, version 1, has other fields than in this run: {said}" in str(
            refused.value
        )
        assert "raise `version=`" in str(refused.value)
        assert "restart the robot" in str(refused.value)
    DeclaredTypes(tmp_path, planned).declare(PAIR)


def test_each_version_is_learnt_and_then_stays(tmp_path: Path) -> None:
    planned = [TypeDescription.of(PAIR)]
    second = pair(2, right=float64, left=float64)
    DeclaredTypes(tmp_path, planned).check(second)
    assert not learnt_types(tmp_path), "a tool teaches the run nothing"
    DeclaredTypes(tmp_path, planned).declare(second)
    with pytest.raises(ChangedType, match="version 2"):
        DeclaredTypes(tmp_path, planned).declare(pair(2, left=float64, right=float64))

    known = KnownTypes([*planned, *(TypeDescription(*one) for one in learnt_types(tmp_path))])
    assert known.describe("team_msgs/Pair").version == 2
    assert str(known.get("team_msgs/Pair", 1)(left=1.0)).startswith("Pair(left=1.0")
    with pytest.raises(
        UnknownType, match="version 3 of team_msgs/msg/Pair is not known here, only version 2"
    ):
        known.get("team_msgs/Pair", 3)
    assert [known.schema("team_msgs/msg/Pair", one) for one in (1, 2, 3)] == [
        "float64 left\nfloat64 right\n",
        "float64 right\nfloat64 left\n",
        None,
    ]


def test_field_of_a_nested_message_is_named(tmp_path: Path) -> None:
    class Inner(Message, name="team_msgs/msg/Inner"):
        x: float64
        y: float64

    class Renamed(Message, name="team_msgs/msg/Inner"):
        x: float64
        z: float64

    DeclaredTypes(tmp_path, []).declare(pair(header=Header, parts=list[Inner]))
    with pytest.raises(ChangedType, match="parts: field 2 was `float64 y` and is `float64 z`"):
        DeclaredTypes(tmp_path, []).declare(pair(header=Header, parts=list[Renamed]))


def test_place_of_the_class_is_named(tmp_path: Path) -> None:
    class Here(Message, name="team_msgs/msg/Pair"):
        right: float64

    with pytest.raises(ChangedType, match=r"test_declared_types.py:\d+: team_msgs/msg/Pair, version 1"):
        DeclaredTypes(tmp_path, [TypeDescription.of(PAIR)]).declare(Here)


def test_other_default_or_text_of_the_same_fields_is_accepted_and_stock_types_are_not_learnt(
    tmp_path: Path,
) -> None:
    class Here(Message, name="team_msgs/msg/Pair"):
        left: float64 = 7.0
        right: float64

    types = DeclaredTypes(tmp_path, [TypeDescription.of(PAIR)])
    types.declare(Here)
    types.declare(LaserScan)
    assert not learnt_types(tmp_path)


def test_version_that_is_used_is_chosen_and_not_one_of_before(tmp_path: Path) -> None:
    """A class was raised to version 2 with --reload, and taken back."""
    DeclaredTypes(tmp_path, []).declare(pair(2, right=float64, left=float64))
    known = KnownTypes([TypeDescription.of(PAIR), *(TypeDescription(*one) for one in learnt_types(tmp_path))])
    used = ChannelName("team_msgs/msg/Pair", 1, "pair")
    assert choose_channel("pair", "", known, {used}) == used


def test_bridge_may_describe_what_a_module_has_taught_the_run(tmp_path: Path) -> None:
    DeclaredTypes(tmp_path, []).declare(PAIR)
    assert learn_type(tmp_path, TypeDescription.of(PAIR)._replace(python_module=""))
