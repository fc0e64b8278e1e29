"""Invalid dependencies are reported with file and line."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.base.problem import SourcePlace
from robbie_mp.base.yaml_reader import YamlNode
from robbie_mp.run.profile.dependencies import read_dependencies
from tests.run.profile.conftest import Robot

NAMES = [f"m{number}" for number in range(6)]


def profile(**depends_on: str) -> str:
    lines = [f"  {name}:\n    class: m:A\n    depends_on: {value}\n" for name, value in depends_on.items()]
    return "modules:\n" + "".join(lines)


def test_names_are_kept_in_their_order(robot: Robot) -> None:
    robot.write("demo", profile(a="[]", b="[a]", c="[b, a]"))
    assert [module.depends_on for module in robot.load().modules] == [(), ("a",), ("b", "a")]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            profile(laser="[]", map="[lazer]"),
            "7: modules.map.depends_on: there is no module 'lazer'; did you mean 'laser'?",
        ),
        (profile(a="[a]"), "4: modules.a.depends_on: a module cannot depend on itself"),
        (profile(a="b", b="[]"), "4: modules.a.depends_on: expected a list of modules; got 'b'"),
        (profile(a="[3]"), "4: modules.a.depends_on: expected the name of a module; got 3"),
        (
            profile(x="[a]", a="[b]", b="[c]", c="[a]"),
            "7: modules.a.depends_on: expected no cycle; got a → b → c → a",
        ),
    ],
)
def test_wrong_dependencies_are_refused(robot: Robot, text: str, problem: str) -> None:
    robot.write("demo", text)
    assert robot.problems() == [f"profiles/demo.yaml:{problem}"]


def test_dependency_on_a_removed_module_is_refused(robot: Robot) -> None:
    robot.write("base", profile(laser="[]", map="[laser]"))
    robot.write("demo", "parents: [base]\nmodules:\n  laser: null\n")
    assert robot.problems() == ["profiles/base.yaml:7: modules.map.depends_on: there is no module 'laser'"]


@given(st.dictionaries(st.sampled_from(NAMES), st.lists(st.sampled_from(NAMES), max_size=3)))
def test_accepted_dependencies_can_be_sorted(wishes: dict[str, list[str]]) -> None:
    here = SourcePlace("test")
    modules = {
        name: YamlNode({"depends_on": YamlNode([YamlNode(other, here) for other in others], here)}, here)
        for name, others in wishes.items()
    }
    names, problems = read_dependencies(modules)
    ordered: set[str] = set()
    for _ in wishes:
        ordered |= {name for name, others in names.items() if ordered.issuperset(others)}
    assert bool(problems) == (ordered != set(wishes))
