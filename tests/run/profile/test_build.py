"""A merged tree becomes a profile. All errors in it are reported with file and line."""

import re

import pytest

from robbie_mp.base.problem import ProfileError
from robbie_mp.run.profile.model import CoreLimits, ModuleSpec, Profile, RestartPolicy, RestartWhen
from robbie_mp.run.supervisor.child_spec import ChildSpec
from tests.run.profile.conftest import Robot


def test_missing_keys_have_their_defaults(robot: Robot) -> None:
    robot.write("demo", "modules: {a: {class: 'm:A'}}")
    profile = robot.load()
    assert profile.modules == (ModuleSpec("a", "m:A"),)
    assert profile.core == CoreLimits()
    assert profile.place_of("modules", "a", "restart", "policy") == profile.place_of("modules", "a")
    assert profile.place_of("core") is None


def test_every_key_of_a_profile_is_understood(robot: Robot) -> None:
    robot.write(
        "demo",
        """
        description: All of it
        modules:
          a:
            class: modules.a:A
            settings: {x: 1}
            restart: {policy: always, max_restarts: 1, within_s: 2, backoff_s: 3, backoff_cap_s: 4,
                      stable_after_s: 5}
            essential: true
            ends_run: true
            start_deadline_s: 6
            stop_grace_s: 7
            memory: {segment_bytes: 8192, limit_bytes: 16384}
            queue: {messages: 8, bytes: 9}
        variables: {radius_m: 0.25, name: r, fast: true, arms: 2}
        core:
            handles: 10
            references: 11
            channels: 12
            subscriptions: 13
            latched_messages: 15
            latched_bytes: 17
            ring_records: 16
            credits: 14
        """,
    )
    profile = robot.load()
    [a] = profile.modules
    assert (a.class_path, a.settings, a.essential, a.ends_run) == ("modules.a:A", {"x": 1}, True, True)
    assert (a.restart.policy, a.restart.max_restarts) == (RestartWhen.ALWAYS, 1)
    assert isinstance(a.restart.policy, RestartWhen)
    times = (a.restart.within_s, a.restart.backoff_s, a.restart.backoff_cap_s, a.restart.stable_after_s)
    assert times == (2.0, 3.0, 4.0, 5.0) and isinstance(a.restart.within_s, float)
    assert (a.start_deadline_s, a.stop_grace_s) == (6.0, 7.0)
    assert (a.memory.segment_bytes, a.memory.limit_bytes) == (8192, 16384)
    assert (a.queue.messages, a.queue.bytes) == (8, 9)
    assert profile.core == CoreLimits(10, 11, 12, 13, 15, 17, 16, 14)
    assert profile.variables == {"radius_m": 0.25, "name": "r", "fast": True, "arms": 2}
    assert profile.description == "All of it"


def in_module(line: str) -> str:
    return f"modules:\n  a:\n    class: m:A\n    {line}\n"


CASES = [
    # what is written, line of the problem, text of the problem
    ("variables: {}\nmodlues: {}", 2, "modlues: unknown key; did you mean 'modules'?"),
    (
        "xyz: 1",
        1,
        "xyz: unknown key; expected one of parents, description, variables, namespace, modules, ",
    ),
    ("- a", 1, "expected a map with the keys of a profile (modules, variables, …)"),
    ("modules: [a]", 1, "modules: expected a map; got ['a']"),
    ("description: 5", 1, "description: expected str; got 5 (int)"),
    ("modules:\n  a: m:A", 2, "modules.a: expected a map; got 'm:A'"),
    ("modules:\n  a: {}", 2, "modules.a: has no class; expected package.module:Class"),
    (
        "modules:\n  a b: {class: 'm:A'}",
        2,
        "modules.a b: expected a name of at most 48 letters, digits, _ and -",
    ),
    ("modules:\n  core: {class: 'm:A'}", 2, "modules.core: this name is taken by the framework; use another"),
    ("modules:\n  a:\n    class: m.A", 3, "modules.a.class: expected package.module:Class; got 'm.A'"),
    ("modules:\n  a:\n    class: [m]", 3, "modules.a.class: expected package.module:Class; got ['m']"),
    (in_module("esential: true"), 4, "modules.a.esential: unknown key; did you mean 'essential'?"),
    (in_module("name: b"), 4, "modules.a.name: unknown key"),
    (in_module("essential: yes"), 4, "modules.a.essential: expected bool; got 'yes' (str)"),
    (in_module("settings: 5"), 4, "modules.a.settings: expected a map; got 5"),
    (in_module("restart: always"), 4, "modules.a.restart: expected a map; got 'always'"),
    (
        in_module("restart:\n      policy: sometimes"),
        5,
        "modules.a.restart.policy: expected one of always, on-failure, never; got 'sometimes' (str)",
    ),
    (
        in_module("restart: {max_restart: 3}"),
        4,
        "modules.a.restart.max_restart: unknown key; did you mean 'max_restarts'?",
    ),
    (
        in_module("restart: {max_restarts: -3}"),
        4,
        "modules.a.restart.max_restarts: expected int, at least 0 and at most 16777216; got -3 (int)",
    ),
    (
        in_module("restart: {max_restarts: 1.5}"),
        4,
        "modules.a.restart.max_restarts: expected int, at least 0 and at most 16777216; got 1.5 (float)",
    ),
    (
        in_module("restart:\n      within_s: .nan"),
        5,
        "modules.a.restart.within_s: expected float, at least 0.1 and at most 1000000000, finite; got nan",
    ),
    (in_module("stop_grace_s: .inf"), 4, "modules.a.stop_grace_s: expected float, at least 0 and at most"),
    (in_module("start_deadline_s: -1"), 4, "modules.a.start_deadline_s: expected float, at least 0.1 and at"),
    (in_module("queue: {messages: 0}"), 4, "modules.a.queue.messages: expected int, at least 1 and at most"),
    (
        in_module("memory:\n      segment_bytes: 1024"),
        5,
        "modules.a.memory.segment_bytes: expected int, at least 4K and at most 256T",
    ),
    (
        in_module("memory: {segment_bytes: 1073741824}"),
        4,
        "modules.a.memory: expected limit_bytes to be at least segment_bytes, 1073741824; got 268435456",
    ),
    ("core:\n  handels: 5", 2, "core.handels: unknown key; did you mean 'handles' or 'channels'?"),
    ("core:\n  credits: 0", 2, "core.credits: expected int, at least 1 and at most 16777216; got 0 (int)"),
    ("settingz:", 1, "settingz: unknown key; expected one of "),
    ("modlues: null", 1, "modlues: unknown key; did you mean 'modules'?"),
    (in_module("settingz:"), 4, "modules.a.settingz: unknown key; did you mean 'settings'?"),
    (
        in_module("restart: {max_restarts:3}"),
        4,
        "modules.a.restart.max_restarts:3: unknown key; write a space after the colon: `max_restarts: 3`",
    ),
    (
        in_module("queue: {messages=3}"),
        4,
        "modules.a.queue.messages=3: unknown key; write a colon and a space: `messages: 3`",
    ),
    ("core: {credits:5}", 1, "core.credits:5: unknown key; write a space after the colon: `credits: 5`"),
    (
        "modules:\n  filter: {class: 'm:A'}\n  filtre: null",
        3,
        "modules.filtre: there is no module 'filtre' to remove; did you mean 'filter'?",
    ),
    (
        "variables: {rate:5}",
        1,
        "variables.rate:5: there is no variable 'rate:5' to remove; write a space after the colon: `rate: 5`",
    ),
    (in_module("topics: {scan:}"), 4, "modules.a.topics.scan: there is no topic 'scan' to remove"),
    ("core:\n  ring_records: 1000", 2, "core.ring_records: expected int, one of 16, 32, 64, 128, 256, 512, "),
]


@pytest.mark.parametrize(("text", "line", "problem"), CASES)
def test_errors_have_file_and_line(robot: Robot, text: str, line: int, problem: str) -> None:
    robot.write("demo", text)
    [got] = robot.problems()
    assert got.startswith(f"profiles/demo.yaml:{line}: {problem}")


def test_mistyped_module_name_is_distinguished_from_a_new_module(robot: Robot) -> None:
    robot.write("base", "modules: {mapping: {class: 'm:A'}}")
    robot.write("demo", "parents: [base]\nmodules:\n  maping: {settings: {x: 1}}")
    assert robot.problems() == ["profiles/demo.yaml:3: modules.maping: has no class; did you mean 'mapping'?"]


def test_all_problems_are_reported_together_in_every_file(robot: Robot) -> None:
    robot.write("base", "modules: {a: {class: 'm:A', esential: true}}\ncore: {credits: x}")
    robot.write("demo", "parents: [base]\nmodules:\n  a:\n    queue: {bytes: 0}\n  b: {}")
    assert sorted(problem.split(" ")[0] for problem in robot.problems()) == [
        "profiles/base.yaml:1:",
        "profiles/base.yaml:2:",
        "profiles/demo.yaml:4:",
        "profiles/demo.yaml:5:",
    ]


def test_files_outside_of_the_current_folder_are_named_in_full(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.write("demo", "x: 1")
    monkeypatch.chdir(robot.root / "profiles")
    assert robot.problems()[0].startswith("demo.yaml:1: ")
    monkeypatch.chdir("/usr")
    [problem] = robot.problems(str(robot.root / "profiles/demo.yaml"))
    assert problem.startswith(f"{robot.root}/profiles/demo.yaml:1: ")


def test_profile_can_be_built_without_a_file() -> None:
    profile = Profile("made", (ModuleSpec("a", "m:A"),))
    assert profile.place_of("modules", "a") is None


def test_restart_policy_of_the_core_is_that_of_the_profile_or_the_default(robot: Robot) -> None:
    robot.write("core", "core: {restart: {max_restarts: 3, within_s: 5}}")
    core = robot.load("core").core
    assert core.restart == RestartPolicy(RestartWhen.ALWAYS, max_restarts=3, within_s=5.0)
    assert ChildSpec.of_core(core, (), {}).module.restart is core.restart
    robot.write("core", "core: {restart: {max_restart: 3}}")
    with pytest.raises(
        ProfileError, match=r"core\.restart\.max_restart: unknown key; did you mean 'max_restarts'"
    ):
        robot.load("core")


def test_times_and_sizes_are_read_with_their_units(robot: Robot) -> None:
    robot.write(
        "demo",
        """
        modules:
          a:
            class: m:A
            stop_grace_s: 1min30s
            restart: {backoff_s: 20ms}
            memory: {limit_bytes: 300M}
            scheduling: {spin_us: 1ms}
        """,
    )
    (module,) = robot.load().modules
    assert (module.stop_grace_s, module.restart.backoff_s) == (90.0, 0.02)
    assert (module.memory.limit_bytes, module.scheduling.spin_us) == (300 << 20, 1000.0)


def test_text_that_is_no_time_or_size_is_reported_with_its_place(robot: Robot) -> None:
    keys = "stop_grace_s: 2m, memory: {limit_bytes: 3s}, restart: {max_restarts: 3K}"
    robot.write("demo", f"modules: {{a: {{class: 'm:A', {keys}}}}}")
    with pytest.raises(ProfileError) as refused:
        robot.load()
    said = str(refused.value)
    assert re.search(r"stop_grace_s: expected float, .*, or with its unit, as in 20ms; got '2m'", said)
    assert re.search(r"limit_bytes: expected int, .*, or with its unit, as in 300M; got '3s'", said)
    assert "max_restarts: expected int" in said
