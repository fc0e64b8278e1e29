"""Parents, null and overrides: which value wins, and its origin."""

import pytest

from robbie_mp.run.profile.model import ModuleSpec, Profile
from tests.run.profile.conftest import Robot


def module(profile: Profile, name: str) -> ModuleSpec:
    return next(module for module in profile.modules if module.name == name)


def test_later_parents_win_over_earlier_ones_and_the_profile_over_all(robot: Robot) -> None:
    robot.write("one", "variables: {a: 1, b: 1, c: 1}")
    robot.write("sim/two", "variables: {b: 2, c: 2}")
    robot.write("demo", "parents: [one, sim/two]\nvariables: {c: 3}")
    profile = robot.load()
    assert profile.variables == {"a": 1, "b": 2, "c": 3}
    places = [str(profile.place_of("variables", key)) for key in "abc"]
    assert places == ["profiles/one.yaml:1", "profiles/sim/two.yaml:1", "profiles/demo.yaml:2"]


def test_maps_are_merged_deeply_and_lists_and_scalars_are_replaced(robot: Robot) -> None:
    robot.write(
        "base",
        """
        modules:
          a:
            class: m:A
            settings: {list: [1, 2], map: {x: 1, y: {z: 1}}, scalar: 1}
            restart: {policy: always, max_restarts: 9}
        """,
    )
    robot.write(
        "demo",
        """
        parents: [base]
        modules:
          a: {settings: {list: [3], map: {y: {w: 2}}, scalar: {now: map}}, restart: {max_restarts: 1}}
        """,
    )
    a = module(robot.load(), "a")
    assert a.settings == {"list": [3], "map": {"x": 1, "y": {"z": 1, "w": 2}}, "scalar": {"now": "map"}}
    assert (a.restart.policy, a.restart.max_restarts) == ("always", 1)


def test_null_removes_a_module_a_setting_or_a_key(robot: Robot) -> None:
    robot.write(
        "base",
        """
        modules:
          a: {class: "m:A", settings: {x: 1, y: 2}, essential: true}
          b: {class: "m:B"}
        variables: {k: 1}
        """,
    )
    robot.write(
        "demo",
        """
        parents: [base]
        modules: {a: {settings: {x: null}, essential: ~}, b: null}
        variables: null
        """,
    )
    profile = robot.load()
    assert [module.name for module in profile.modules] == ["a"]
    assert profile.modules[0].settings == {"y": 2}
    assert not profile.modules[0].essential
    assert profile.variables == {}


def test_parent_can_remove_a_key_of_an_earlier_parent(robot: Robot) -> None:
    robot.write("base", "modules: {a: {class: 'm:A'}, camera: {class: 'm:C'}}")
    robot.write("without_camera", "modules: {camera: null}")
    robot.write("demo", "parents: [base, without_camera]")
    assert [module.name for module in robot.load().modules] == ["a"]


def test_null_in_a_list_is_kept(robot: Robot) -> None:
    robot.write("demo", "modules: {a: {class: 'm:A', settings: {x: [1, null]}}}")
    assert module(robot.load(), "a").settings == {"x": [1, None]}


def test_modules_keep_the_order_of_their_first_appearance(robot: Robot) -> None:
    robot.write("base", "modules: {c: {class: 'm:C'}, a: {class: 'm:A'}}")
    robot.write("demo", "parents: [base]\nmodules: {b: {class: 'm:B'}, a: {essential: true}}")
    assert [module.name for module in robot.load().modules] == ["c", "a", "b"]


def test_common_ancestor_does_not_undo_what_one_parent_changed(robot: Robot) -> None:
    robot.write("base", "variables: {speed: 1}")
    robot.write("fast", "parents: [base]\nvariables: {speed: 2}")
    robot.write("loud", "parents: [base]\nvariables: {volume: 11}")
    robot.write("demo", "parents: [fast, loud]")
    assert robot.load().variables == {"speed": 2, "volume": 11}


def test_profiles_and_parents_may_be_empty(robot: Robot) -> None:
    robot.write("base", "")
    robot.write("demo", "parents: [base]\nmodules:\n")
    profile = robot.load()
    assert (profile.modules, dict(profile.variables), profile.description) == ((), {}, "")


def test_cycle_shows_its_chain(robot: Robot) -> None:
    robot.write("demo", "parents: [a]")
    robot.write("a", "variables: {}\nparents:\n- b\n- c")
    robot.write("b", "")
    robot.write("c", "parents: [a]")
    assert robot.problems() == ["profiles/c.yaml:1: parents: a profile cannot be its own ancestor: a → c → a"]
    robot.write("self", "parents: [self]")
    assert robot.problems("self") == [
        "profiles/self.yaml:1: parents: a profile cannot be its own ancestor: self → self"
    ]


def test_missing_parent_is_reported_with_its_line_and_a_similar_name(robot: Robot) -> None:
    robot.write("base", "")
    robot.write("demo", "parents:\n- base\n- bse")
    [problem] = robot.problems()
    assert problem == "profiles/demo.yaml:3: there is no profile 'bse'; did you mean 'base'?"


@pytest.mark.parametrize(
    ("parents", "problem"),
    [
        ("base", "profiles/demo.yaml:2: parents: expected a list of profile names, as in `parents: [base]`"),
        (
            "{a: b}",
            "profiles/demo.yaml:2: parents: expected a list of profile names, as in `parents: [base]`",
        ),
        ("[1]", "profiles/demo.yaml:2: parents: expected the name of a profile; got 1"),
        ("[[a]]", "profiles/demo.yaml:2: parents: expected the name of a profile; got ['a']"),
    ],
)
def test_parents_of_a_wrong_type_are_refused(robot: Robot, parents: str, problem: str) -> None:
    robot.write("demo", f"variables: {{}}\nparents: {parents}")
    assert robot.problems() == [problem]


@pytest.mark.parametrize("name", ["../outside", "/etc/passwd", ".", "a//b", "", "demo.yaml"])
def test_parent_outside_of_the_profiles_folder_is_refused(robot: Robot, name: str) -> None:
    (robot.root / "outside.yaml").touch()
    robot.write("demo", f"parents: ['{name}']")
    assert robot.problems()[0].startswith(f"profiles/demo.yaml:1: there is no profile {name!r}")


def test_broken_yaml_of_a_parent_is_reported_there(robot: Robot) -> None:
    robot.write("base", "a: [")
    robot.write("demo", "parents: [base]")
    assert robot.problems()[0].startswith("profiles/base.yaml:1: YAML: ")


OVERRIDDEN = """
modules:
  a: {class: "m:A", settings: {x: 1, m: {p: 1}}}
"""


def test_overrides_set_settings(robot: Robot) -> None:
    robot.write("demo", OVERRIDDEN)
    profile = robot.load("demo", "a.x=2e-1", "a.y=[1, 2]", "a.m={q: no}", "a.z=x=y")
    assert profile.modules[0].settings == {"x": 0.2, "m": {"p": 1, "q": "no"}, "y": [1, 2], "z": "x=y"}
    assert str(profile.place_of("modules", "a", "settings", "x")) == "--set a.x"


def test_override_sets_what_the_black_box_does(robot: Robot) -> None:
    robot.write("demo", OVERRIDDEN)
    box = robot.load("demo", "black_box.spool_s=0", "black_box.before_s=30").black_box
    assert box is not None and box.settings == {"spool_s": 0, "before_s": 30}


def test_override_does_not_switch_a_black_box_on(robot: Robot) -> None:
    robot.write("demo", OVERRIDDEN + "black_box: false\n")
    assert robot.problems("demo", "black_box.spool_s=0") == [
        "--set black_box.spool_s: the profile has no black box (black_box: false)"
    ]


def test_of_two_overrides_the_later_wins_and_null_removes(robot: Robot) -> None:
    robot.write("demo", OVERRIDDEN)
    profile = robot.load("demo", "a.x=2", "a.x=3", "a.m=null")
    assert profile.modules[0].settings == {"x": 3}


def test_relative_paths_of_overrides_start_from_the_current_folder(robot: Robot) -> None:
    robot.write("demo", OVERRIDDEN)
    assert robot.load("demo", "a.x=file").modules[0].folder_of == {"x": robot.root}
    assert robot.load("demo").modules[0].folder_of == {}


@pytest.mark.parametrize(
    ("override", "problem"),
    [
        ("a.x", "expected MODULE.SETTING=VALUE"),
        ("a=1", "expected MODULE.SETTING=VALUE"),
        ("=1", "expected MODULE.SETTING=VALUE"),
        ("a.x=[1", "YAML: while parsing a flow sequence expected ',' or ']', but got '<stream end>'"),
        ("b.x=1", "there is no module 'b'; modules: a"),
        ("aa.x=1", "there is no module 'aa'; did you mean 'a'?"),
    ],
)
def test_invalid_override_is_reported_without_its_value(robot: Robot, override: str, problem: str) -> None:
    robot.write("demo", OVERRIDDEN)
    assert robot.problems("demo", override) == [f"--set {override.partition('=')[0]}: {problem}"]
