"""docs/profiles.md names every key with the default that the code has."""

import re
from dataclasses import fields, is_dataclass

import pytest
import yaml

from robbie_mp.run.profile.build import PROFILE_KEYS
from robbie_mp.run.profile.model import (
    CheckpointPolicy,
    CoreLimits,
    MemoryLimits,
    ModuleSpec,
    QueueLimits,
    RestartPolicy,
    Scheduling,
    SpareInterpreters,
    ToolLimits,
    TraceSettings,
)
from tests._support.places import PROJECT
from tests.run.profile.conftest import Robot

TEXT = (PROJECT / "docs" / "profiles.md").read_text()


def documented(heading: str) -> dict[str, str]:
    """Return the default of each key in the table below a heading."""
    section = re.split(r"^#+ ", TEXT.split(f"# {heading}\n")[1], flags=re.MULTILINE)[0]
    rows = [row.split("|") for row in section.splitlines() if row.startswith("| `")]
    return {row[1].strip(" `"): row[3].strip(" `") for row in rows}


def in_yaml(value: object) -> str:
    if value is None:
        return "null"
    if is_dataclass(value) and not isinstance(value, type):  # what differs from the class's own defaults
        other = {
            key: content for key, content in vars(value).items() if content != getattr(type(value)(), key)
        }
        return "{" + ", ".join(f"{key}: {in_yaml(content)}" for key, content in other.items()) + "}"
    return str(value).lower() if isinstance(value, bool) else str(value)


@pytest.mark.parametrize(
    ("heading", "section"),
    [
        ("restart", RestartPolicy),
        ("memory", MemoryLimits),
        ("queue", QueueLimits),
        ("checkpoint", CheckpointPolicy),
        ("scheduling", Scheduling),
        ("core", CoreLimits),
        ("tools", ToolLimits),
    ],
)
def test_every_key_of_a_section_is_documented_with_its_default(heading: str, section: type) -> None:
    assert is_dataclass(section)
    defaults = section()
    assert documented(heading) == {
        field.name: in_yaml(getattr(defaults, field.name)) for field in fields(section)
    }


def test_every_key_of_a_module_is_documented_with_its_default() -> None:
    plain = {
        field.name: in_yaml(field.default)
        for field in fields(ModuleSpec)
        if isinstance(field.default, bool | float)
    }
    table = documented("Keys of a module")
    assert table == {
        "class": "required",
        "program": "-",
        "if": "true",
        "namespace": "''",
        **dict.fromkeys(
            ["settings", "topics", "restart", "memory", "queue", "checkpoint", "scheduling"], "{}"
        ),
        "depends_on": "[]",
        **dict.fromkeys(["handler_deadline_s", "record"], "null"),
        **plain,
    }


def test_every_key_of_spares_is_documented_with_its_default() -> None:
    default = SpareInterpreters()
    assert documented("spares") == {"count": str(default.count), "imports": str(default.imports)}


def test_every_key_of_the_trace_is_documented_with_its_default() -> None:
    default = vars(TraceSettings())
    record = f"[{', '.join(default.pop('record'))}]"
    assert documented("trace") == {"record": record} | {key: in_yaml(value) for key, value in default.items()}


def test_every_key_of_a_profile_is_documented() -> None:
    assert tuple(documented("Keys of a profile")) == PROFILE_KEYS


def test_example_is_a_profile(robot: Robot) -> None:
    example = TEXT.split("```yaml\n")[1].split("```")[0]
    robot.write("sim/arena", example)
    for parent in yaml.safe_load(example)["parents"]:
        robot.write(parent, "modules: {camera: {class: 'm:Camera'}}")  # which the example removes
    profile = robot.load("sim/arena")
    assert [module.name for module in profile.modules] == ["mapping"]
    assert profile.core.handles == 32768
