"""Variables, conditions, and modules left out on the command line."""

from pathlib import Path
from typing import Any

import pytest

from robbie_mp.base.problem import ProfileError
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.show import as_profile, as_tree, origins
from tests.run.profile.conftest import Robot

DEMO = """
variables:
  simulated: true
  rate_hz: 10.0
  robot: lisa
  count: 3
modules:
  camera:
    class: m:Camera
    if: ${simulated}
    settings:
      rate_hz: ${rate_hz}
      file: maps/${robot}-${count}.png
      literal: $${robot}
      list: [1, "${count}"]
  laser:
    class: m:Laser
    if: not ${simulated}
  both:
    class: m:Both
    depends_on: [camera, laser]
"""


def load(*variables: str, overrides: tuple[str, ...] = (), **names: Any):  # type: ignore[no-untyped-def]
    return load_profile("demo", overrides=overrides, variables=variables, **names)


def problems(*variables: str, **names: Any) -> list[str]:
    with pytest.raises(ProfileError) as caught:
        load(*variables, **names)
    return [str(problem) for problem in caught.value.problems]


def test_value_that_is_a_variable_keeps_its_type_and_one_in_a_text_is_inserted(robot: Robot) -> None:
    robot.write("demo", DEMO)
    profile = load()
    assert profile.modules[0].settings == {
        "rate_hz": 10.0, "file": "maps/lisa-3.png", "literal": "${robot}", "list": [1, 3],
    }  # fmt: skip
    assert profile.variables == {"simulated": True, "rate_hz": 10.0, "robot": "lisa", "count": 3}


def test_command_line_gives_variables_other_values_of_the_same_type(robot: Robot) -> None:
    robot.write("demo", DEMO)
    profile = load("rate_hz=5", "robot=7", "count=0x10")
    assert profile.modules[0].settings["rate_hz"] == 5.0
    assert profile.modules[0].settings["file"] == "maps/7-16.png"


def test_condition_decides_whether_a_module_runs(robot: Robot) -> None:
    robot.write("demo", DEMO)
    assert [module.name for module in load().modules] == ["camera", "both"]
    profile = load("simulated=false")
    assert [module.name for module in profile.modules] == ["laser", "both"]
    assert profile.left_out == {"camera": "if: ${simulated}"}
    assert profile.modules[1].depends_on == ("laser",), "it cannot wait for a module that does not run"


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("true", True), ("false", False), ("${yes}", True), ("${no}", False), ("not ${no}", True),
        ("${yes} and ${no}", False), ("${yes} or ${no}", True), ("not not ${yes}", True),
        ("${no} and ${no} or ${yes}", True), ("${no} and (${no} or ${yes})", False),
        ("not (${no} or ${yes})", False), ("${yes} or ${no} and ${no}", True), ("not ${no} and true", True),
    ],
)  # fmt: skip
def test_conditions_bind_as_in_python(robot: Robot, condition: str, holds: bool) -> None:
    text = f"variables: {{yes: true, no: false}}\nmodules:\n  a:\n    class: m:A\n    if: {condition}\n"
    robot.write("demo", text)
    assert bool(load().modules) is holds
    as_in_python = (
        condition.replace("${", "").replace("}", "").replace("true", "True").replace("false", "False")
    )
    assert eval(as_in_python, {"yes": True, "no": False}) is holds


@pytest.mark.parametrize(
    ("condition", "problem"),
    [
        ("simulated", "'simulated' is not a variable; write ${simulated}"),
        ("${simulatd}", "there is no variable 'simulatd'; did you mean 'simulated'?"),
        ("${robot}", "robot is 'lisa' (str, profiles/demo.yaml:2), not a bool"),
        ("${simulated} and", "a variable is missing at the end"),
        ("${simulated} ${simulated}", "'${simulated}' follows where the condition should end"),
        ("(${simulated}", "a closing parenthesis is missing"),
        ("${simulated} == true", "'==' follows where the condition should end"),
        ("3", "got 3"),
    ],
)
def test_wrong_conditions_say_where_and_what(robot: Robot, condition: str, problem: str) -> None:
    robot.write(
        "demo",
        "variables:\n  robot: lisa\n  simulated: true\n"
        f"modules:\n  a:\n    class: m:A\n    if: {condition}\n",
    )
    (got,) = problems()
    assert got.startswith(
        "profiles/demo.yaml:7: modules.a.if: expected true, false, or variables with and, or, "
    )
    assert got.endswith(problem)


CASES = [
    (
        "count: ${conut}", (),
        "profiles/demo.yaml:5: ${conut}: there is no variable 'conut'; did you mean 'count'?",
    ),
    ("a: x${}y", (), "profiles/demo.yaml:5: ${}: there is no variable ''; variables: count, on"),
    ("a: 1", ("conut=1",), "--var conut: there is no variable 'conut'; did you mean 'count'?"),
    ("a: 1", ("count",), "--var count: expected NAME=VALUE"),
    (
        "a: 1", ("count=many",),
        "--var count: expected int, as its default at profiles/demo.yaml:6; got 'many'",
    ),
    ("a: 1", ("on=1",), "--var on: expected bool, as its default at profiles/demo.yaml:6; got '1'"),
    ("a: 1", ("on=",), "--var on: expected bool, as its default at profiles/demo.yaml:6; got ''"),
]  # fmt: skip


@pytest.mark.parametrize(("setting", "given", "problem"), CASES)
def test_wrong_variables_are_errors_with_their_place(
    robot: Robot, setting: str, given: tuple[str, ...], problem: str
) -> None:
    module = f"modules:\n  a:\n    class: m:A\n    settings:\n      {setting}\n"
    robot.write("demo", module + "variables: {count: 3, on: true}\n")
    assert problems(*given) == [problem]


@pytest.mark.parametrize(
    ("declared", "problem"),
    [
        ("a-b: 1", "variables.a-b: expected a name of letters, digits and _"),
        ("a: [1]", "variables.a: expected bool, int, float or str; got [1]"),
        ("b: ${a}", "variables.b: a variable cannot contain another one; write its value"),
    ],
)
def test_wrong_declarations_are_errors_with_their_place(robot: Robot, declared: str, problem: str) -> None:
    robot.write("demo", f"variables:\n  {declared}\n")
    assert problems() == [f"profiles/demo.yaml:2: {problem}"]


def test_error_in_an_inserted_value_names_the_place_and_the_option(robot: Robot) -> None:
    robot.write(
        "demo", "variables: {n: 3}\nmodules:\n  a:\n    class: m:A\n    queue:\n      messages: ${n}\n"
    )
    assert problems("n=-1") == [
        "profiles/demo.yaml:6 (--var n): modules.a.queue.messages: expected int, at least 1 and at most "
        "16777216; got -1 (int)"
    ]


BASE = """
variables: {name: base, kept: 1}
modules: {a: {class: "m:A", settings: {a: "${name}", b: "${only_here}"}}}
"""
CHILD = """
parents: [base]
variables: {name: child, only_here: 2}
modules: {a: {settings: {c: "${kept}"}}}
"""


def test_child_changes_the_defaults_of_its_parents_and_the_text_may_be_in_either(robot: Robot) -> None:
    robot.write("base", BASE)
    robot.write("demo", CHILD)
    [module] = load().modules
    assert module.settings == {"a": "child", "b": 2, "c": 1}
    [module] = load("name=typed").modules
    assert module.settings["a"] == "typed"


def test_override_may_name_a_variable_and_comes_before_it_is_replaced(robot: Robot) -> None:
    robot.write("demo", DEMO)
    assert load(overrides=("camera.file=${robot}.jpg",)).modules[0].settings["file"] == "lisa.jpg"


def test_relative_path_typed_as_a_variable_starts_from_the_current_folder(robot: Robot) -> None:
    robot.write(
        "demo", "variables: {f: maps/a.png}\nmodules: {a: {class: 'm:A', settings: {file: '${f}'}}}\n"
    )
    assert not load().modules[0].folder_of
    assert load("f=b.png").modules[0].folder_of == {"file": Path.cwd()}


def test_module_is_left_out_by_name(robot: Robot) -> None:
    robot.write("demo", DEMO)
    profile = load(without=("camera",))
    assert [module.name for module in profile.modules] == ["both"]
    assert profile.left_out["camera"] == "--without camera"
    assert problems(without=("camra",)) == [
        "--without camra: there is no module 'camra'; did you mean 'camera'?"
    ]


def test_all_but_the_named_modules_are_left_out(robot: Robot) -> None:
    robot.write("demo", "modules: {a: {class: 'm:A'}, b: {class: 'm:A', depends_on: [a]}, c: {class: 'm:A'}}")
    profile = load(only=("b",))
    assert [(module.name, module.depends_on) for module in profile.modules] == [("b", ())]
    assert profile.left_out == {"a": "--only b", "c": "--only b"}
    assert problems(only=("d", "b")) == ["--only d: there is no module 'd'; modules: a, b, c"]


def test_module_that_is_left_out_otherwise_cannot_be_the_only_one(robot: Robot) -> None:
    robot.write("demo", DEMO)
    assert problems(only=("camera",), without=("camera",)) == [
        "--only camera: camera is left out (--without camera)"
    ]


def test_source_of_the_clock_cannot_be_left_out(robot: Robot) -> None:
    robot.write("demo", "modules: {time: {class: 'm:A'}}\nclock:\n  source: time\n")
    text = "clock.source: time is left out (--without time), but it turns the clock"
    assert problems(without=("time",)) == [f"profiles/demo.yaml:3: {text}"]


def test_unquoted_variable_in_a_flow_map_is_explained(robot: Robot) -> None:
    robot.write("demo", "variables: {on: true}\nmodules: {a: {class: 'm:A', if: ${on}}}\n")
    (got,) = problems()
    assert got.startswith("profiles/demo.yaml:2: YAML: ")
    assert got.endswith('inside { } and [ ], quote variables: "${name}"')


def test_shown_profile_has_the_values_and_where_they_come_from(robot: Robot) -> None:
    robot.write("demo", DEMO)
    profile = load("rate_hz=5")
    tree = as_tree(profile, {})
    origin = origins(profile, tree)
    assert origin["variables", "rate_hz"] == "--var rate_hz"
    assert origin["modules", "camera", "settings", "rate_hz"] == "profiles/demo.yaml:12 (--var rate_hz)"
    assert origin["modules", "camera", "settings", "file"] == "profiles/demo.yaml:13"
    robot.write("shown", as_profile(load(), {}))
    again = robot.load("shown")
    assert again.modules == load().modules


def test_topics_and_namespace_are_read_and_merged(robot: Robot) -> None:
    robot.write("base", "modules: {a: {class: 'm:A', topics: {scan: front, map: /map}}, b: {class: 'm:B'}}")
    robot.write(
        "demo",
        """
        parents: [base]
        variables: {team: red}
        namespace: ${team}/one
        modules:
          a: {topics: {map: null, "": all}}
          b: {namespace: ""}
        """,
    )
    a, b = load().modules
    assert (dict(a.topics), a.namespace) == ({"scan": "front", "": "all"}, "red/one")
    assert (dict(b.topics), b.namespace) == ({}, "")


@pytest.mark.parametrize(
    ("key", "problem"),
    [
        ("topics: [a]", "modules.a.topics: expected a map; got ['a']"),
        ("topics: {a: 1}", "modules.a.topics.a: expected the name of a topic; got 1"),
        ("topics: {a: a}", "modules.a.topics.a: expected another name than 'a'"),
        ("namespace: red/", "modules.a.namespace: expected letters, digits, _ and -, with / between parts"),
        ("namespace: 1", "modules.a.namespace: expected letters"),
        ("topic: {a: b}", "modules.a.topic: unknown key; did you mean 'topics'?"),
    ],
)
def test_wrong_topics_and_namespaces_are_errors_with_their_place(
    robot: Robot, key: str, problem: str
) -> None:
    robot.write("demo", f"modules:\n  a:\n    class: m:A\n    {key}\n")
    (got,) = problems()
    assert got.startswith(f"profiles/demo.yaml:4: {problem}")


def test_black_box_is_left_out_as_a_module_is(robot: Robot) -> None:
    robot.write("demo", DEMO)
    assert load_profile("demo").black_box is not None
    without = load_profile("demo", without=("black_box",))
    assert without.black_box is None and without.modules == load_profile("demo").modules
    beside = load_profile("demo", only=("camera", "black_box"))
    assert beside.black_box is not None and [one.name for one in beside.modules] == ["camera"]
