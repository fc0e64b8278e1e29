"""Robots describe their message types over the link; what they describe is checked and bounded."""

import logging
from pathlib import Path

import pytest

from robbie_mp.connect.link.described_types import MAX_DESCRIBED, MAX_TYPES, LinkedTypes
from robbie_mp.messages import LinkType, LinkTypes
from robbie_mp.messages.descriptions import TypeDescription
from robbie_mp.run.learnt_types import learnt_types

SOIL = TypeDescription("zoo/msg/Soil", 2, "float64 moisture_percent", "zoo.messages")
LOG = logging.getLogger("link")


def told(*types: LinkType) -> bytes:
    return LinkTypes(robot="red", types=list(types)).encode()


def soil(schema: str = SOIL.schema, name: str = SOIL.name) -> LinkType:
    return LinkType(name=name, version_number=2, schema=schema)


def everything(_type_name: str) -> bool:
    return True


def test_type_that_one_robot_describes_is_learnt_by_the_run_of_another(tmp_path: Path) -> None:
    described = LinkedTypes([SOIL], None, LOG).describe("red", ["zoo/*"])
    laptop = LinkedTypes([], tmp_path, LOG)
    assert laptop.learn("red", described.encode(), everything)
    assert laptop.known.describe("Soil").schema == SOIL.schema
    assert [one[:3] for one in learnt_types(tmp_path)] == [SOIL[:3]]
    assert laptop.learn("red", described.encode(), everything)  # again, after a restart


def test_types_that_are_not_sent_are_not_described() -> None:
    assert LinkedTypes([SOIL], None, LOG).describe("red", ["sensor_msgs/*"]).types == []


def test_type_that_a_robot_may_not_send_is_not_learnt(tmp_path: Path) -> None:
    laptop = LinkedTypes([], tmp_path, LOG)
    assert laptop.learn("red", told(soil()), lambda _type_name: False)
    assert learnt_types(tmp_path) == []


@pytest.mark.parametrize(
    ("described", "problem"),
    [
        (soil("float64 dampness"), "another definition"),
        (soil("float99 x", "zoo/msg/Air"), "float99"),
        (soil("float64 x", "../../etc/passwd"), "passwd"),
        (soil("float64 x", "zoo/msg/Ai\nr"), "zoo/msg/Ai"),
    ],
)
def test_other_definitions_and_what_is_no_type_are_refused_with_a_reason(
    described: LinkType, problem: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    laptop = LinkedTypes([SOIL], tmp_path, LOG)
    assert laptop.learn("red", told(described), everything)
    assert problem in caplog.messages[0] and "\n" not in caplog.messages[0]
    assert learnt_types(tmp_path) == []


def test_what_a_robot_describes_is_bounded(tmp_path: Path) -> None:
    laptop = LinkedTypes([], tmp_path, LOG)
    many = told(*[soil("float64 x", f"zoo/msg/Type{number}") for number in range(MAX_TYPES + 10)])
    assert laptop.learn("red", many, everything)
    assert len(learnt_types(tmp_path)) == MAX_TYPES
    assert [laptop.learn("red", many, everything) for _ in range(MAX_DESCRIBED // MAX_TYPES)][-1] is False
    assert not laptop.learn("red", b"nonsense", everything)
