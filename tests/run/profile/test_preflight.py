"""Classes and settings are checked safely, and errors of the profile are distinguished from failing code."""

import json
import os
from collections.abc import Generator
from pathlib import Path

import pytest

from robbie_mp.base.problem import ProfileError
from robbie_mp.run.profile.checking_process import PreflightError
from robbie_mp.run.profile.model import ModuleSpec, Profile
from robbie_mp.run.profile.preflight import preflight, runnable
from tests.run.profile.conftest import PLAIN, Robot, write_class

MAPPING = """
from pathlib import Path
from base_of_modules import Base
from robbie_mp import REQUIRED, SettingError, setting

class Mapping(Base):
    resolution_m: float = setting(0.05, "edge of a grid cell", minimum=0)
    map_file: Path = setting(Path("map.png"), "where the map is kept")
    log_file: Path | None = setting(None, "log", must_exist=True)

    @classmethod
    def check(cls, settings):
        assert isinstance(settings["map_file"], Path) and settings["map_file"].is_absolute()
        if settings["resolution_m"] == 13:
            raise SettingError("13 brings bad luck", "resolution_m")
        if settings["resolution_m"] == 14:
            raise SettingError("this is all wrong")
        if settings["resolution_m"] == 15:
            raise ZeroDivisionError("bug in check")

class Needy(Base):
    port: str = setting(REQUIRED, "serial port")

class Unrelated:
    pass
"""


@pytest.fixture
def mapper(robot: Robot) -> Robot:
    robot.write_code("mods.mapping", MAPPING)
    robot.write(
        "demo",
        """
        modules:
          mapping:
            class: mods.mapping:Mapping
            settings:
              resolution_m: 1
        """,
    )
    return robot


def test_returned_settings_are_complete_with_absolute_paths(mapper: Robot) -> None:
    findings = mapper.preflight()
    assert findings.settings == {
        "mapping": {"resolution_m": 1.0, "map_file": f"{mapper.root}/map.png", "log_file": None}
    }
    assert findings.failures == {}


def test_relative_paths_in_overrides_start_from_the_current_folder(
    mapper: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = mapper.root / "logs"
    here.mkdir()
    (here / "run.mcap").touch()
    monkeypatch.chdir(here)
    settings = mapper.preflight("mapping.log_file=run.mcap").settings["mapping"]
    assert settings["log_file"] == f"{here}/run.mcap"
    assert settings["map_file"] == f"{mapper.root}/map.png"


@pytest.mark.parametrize(
    ("class_path", "problem"),
    [
        ("mods.maping:Mapping", "there is no Python module 'mods.maping'; did you mean 'mods.mapping'?"),
        ("mod.mapping:Mapping", "there is no Python module 'mod'; did you mean 'mods'?"),
        ("no_such_module:A", "there is no Python module 'no_such_module'"),
        ("mods.mapping.deeper:A", "there is no Python module 'mods.mapping.deeper'"),
        ("mods.mapping:Maping", "mods.mapping has no class 'Maping'; did you mean 'Mapping'?"),
        ("mods.mapping:Unrelated", "mods.mapping:Unrelated is not derived from base_of_modules.Base"),
        ("mods.mapping:setting", "mods.mapping:setting is not derived from base_of_modules.Base"),
    ],
)
def test_class_that_is_not_a_module_is_an_error_of_the_profile(
    mapper: Robot, class_path: str, problem: str
) -> None:
    write_class(mapper, class_path)
    assert mapper.preflight_problems() == [f"profiles/demo.yaml:3: modules.a.class: {problem}"]


@pytest.mark.parametrize(
    ("override", "problem"),
    [
        ("resolution_m=-1", "Mapping.resolution_m: expected float, at least 0; got -1.0 (float)"),
        ("resolution_m=a", "Mapping.resolution_m: expected float, at least 0; got 'a' (str)"),
        ("resolution=1", "Mapping has no setting 'resolution'; did you mean 'resolution_m'?"),
        ("resolution_m=13", "13 brings bad luck"),
        ("resolution=null", "Mapping has no setting 'resolution'; did you mean 'resolution_m'?"),
    ],
)
def test_wrong_setting_is_reported_where_it_was_set(mapper: Robot, override: str, problem: str) -> None:
    assert mapper.preflight_problems(f"mapping.{override}") == [
        f"--set mapping.{override.partition('=')[0]}: modules.mapping.settings: {problem}"
    ]


def test_settings_of_files_are_reported_with_their_lines(mapper: Robot) -> None:
    mapper.write(
        "demo",
        """
        modules:
          mapping:
            class: mods.mapping:Mapping
            settings:
              resolution_m: x
              log_file: lost.mcap
              oops: 1
          needy:
            class: mods.mapping:Needy
          other:
            class: mods.mapping:Other
        """,
    )
    assert [problem.split(": ")[0] for problem in mapper.preflight_problems()] == [
        "profiles/demo.yaml:8",  # unknown names come first
        "profiles/demo.yaml:6",
        "profiles/demo.yaml:7",
        "profiles/demo.yaml:9",
        "profiles/demo.yaml:12",
    ]


@pytest.mark.parametrize(
    ("settings", "remedy"),
    [
        ("{resolution_m:0.5}", "'resolution_m:0.5'; write a space after the colon: `resolution_m: 0.5`"),
        ("{resolution_m=0.5}", "'resolution_m=0.5'; write a colon and a space: `resolution_m: 0.5`"),
        ("{oops: }", "'oops'; it has "),
    ],
)
def test_unknown_setting_with_an_empty_value_is_reported(mapper: Robot, settings: str, remedy: str) -> None:
    mapper.write("demo", f"modules:\n  a:\n    class: mods.mapping:Mapping\n    settings: {settings}\n")
    [problem] = mapper.preflight_problems()
    assert problem.startswith(f"profiles/demo.yaml:4: modules.a.settings: Mapping has no setting {remedy}")


def test_unknown_setting_of_the_black_box_with_an_empty_value_is_reported(robot: Robot) -> None:
    robot.write("demo", f"modules: {{a: {PLAIN}}}\nblack_box: {{spool_s:1}}")
    with pytest.raises(ProfileError, match=r"demo\.yaml:2: modules\.black_box\.settings: .*write a space"):
        preflight(robot.load().with_black_box())


def test_error_without_a_setting_is_reported_at_the_settings(mapper: Robot) -> None:
    mapper.write(
        "demo", "modules:\n  a:\n    class: mods.mapping:Mapping\n    settings:\n      resolution_m: 14"
    )
    assert mapper.preflight_problems() == ["profiles/demo.yaml:4: modules.a.settings: this is all wrong"]


def test_class_with_a_wrong_declaration_is_reported(robot: Robot) -> None:
    robot.write_code(
        "m",
        "from base_of_modules import Base\nfrom robbie_mp.module.settings import setting\n"
        "class A(Base):\n    x = setting(1, 'no type')",
    )
    write_class(robot, "m:A")
    flaw = "A.x needs a type, as in `x: float = setting(…)`"
    assert robot.preflight_problems() == [f"profiles/demo.yaml:2: modules.a.settings: {flaw}"]


@pytest.mark.parametrize(
    ("code", "failure"),
    [
        ("raise RuntimeError('broken lens')", "RuntimeError: broken lens"),
        ("import no_such_thing", "ModuleNotFoundError: No module named 'no_such_thing'"),
        ("import mods.no_such_thing", "ModuleNotFoundError: No module named 'mods.no_such_thing'"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("raise KeyboardInterrupt", "KeyboardInterrupt"),
        ("import os; os._exit(0)", "mods.bad: ended with exit code 0 while it was imported"),
        ("import ctypes; ctypes.string_at(0)", "mods.bad: was killed by SIGSEGV while it was imported"),
        ("import os; os.abort()", "mods.bad: was killed by SIGABRT while it was imported"),
    ],
)
def test_failing_code_is_left_to_the_supervisor(robot: Robot, code: str, failure: str) -> None:
    robot.write_code("mods.bad", code)
    robot.write(
        "demo",
        f"""
        modules:
          before: {PLAIN}
          bad: {{class: "mods.bad:Bad", settings: {{x: 1}}}}
          worse: {{class: "mods.bad:Worse"}}
          after: {PLAIN}
        """,
    )
    findings = robot.preflight()
    assert {name: text.strip().splitlines()[-1] for name, text in findings.failures.items()} == {
        "bad": failure,
        "worse": failure,
    }
    assert findings.settings.keys() == {"before", "after"}  # {} must not be mistaken for checked settings


def test_mistake_in_a_file_of_two_modules_is_reported_once_and_no_module_starts(robot: Robot) -> None:
    robot.write_code("mods.bad", "def")
    robot.write(
        "demo",
        f"""
        modules:
          before: {PLAIN}
          bad: {{class: "mods.bad:Bad", optional: true}}
          worse: {{class: "mods.bad:Worse"}}
        """,
    )
    assert robot.preflight_problems() == ["mods/bad.py:1: SyntaxError: invalid syntax in `def`"]


def test_file_that_was_saved_half_way_is_reported_without_a_line(robot: Robot) -> None:
    (robot.root / "half.py").write_text("class A:\n    def setup(self):\n        ")
    write_class(robot, "half:A")
    (problem,) = robot.preflight_problems()
    assert problem.startswith("half.py:3: IndentationError: expected an indented block")
    assert problem.endswith("on line 2")


@pytest.mark.parametrize("file", ["logging.py", "robbie_mp.py", "random/__init__.py"])
def test_file_that_hides_a_module_which_the_processes_need_is_refused(robot: Robot, file: str) -> None:
    write_class(robot, "base_of_modules:Plain")
    robot.write_code("this", "")  # nothing that Robbie-MP imports
    robot.preflight()
    path = robot.root / file
    path.parent.mkdir(exist_ok=True)
    path.touch()
    (problem,) = robot.preflight_problems()
    assert problem.startswith(f"{file}:1: hides the module ") and problem.endswith("; rename it")


def test_constructors_and_methods_made_in_other_ways_are_no_mistakes(robot: Robot) -> None:
    robot.write_code(
        "mods.good",
        """
        from functools import partial
        from robbie_mp import Module
        from robbie_mp.messages import LaserScan

        class Mixed:
            def __init__(self, context):
                super().__init__(context)

            def on_scan(self, scan, extra=1): ...

        class Good(Mixed, Module):
            def setup(self, *_unused):
                self.chosen = self.on_scan if self.name else self.on_other
                self.subscribe(LaserScan, self.chosen, topic="front/left-1.5")
                self.subscribe(LaserScan, self.make_handler(), topic="~/scan")
                self.subscribe(LaserScan, self.on_other)
                self.every(1.0, partial(self.on_other, None))
                self.every(1.0, print)

            def make_handler(self):
                return self.on_scan

            @staticmethod
            def on_other(scan): ...

        class Own(Module):
            def subscribe(self, what, whom): ...

            def setup(self):
                self.subscribe("weather", None)

        Made = type("Made", (Good,), {})
        """,
    )
    lines = [f"  {name.lower()}: {{class: 'mods.good:{name}'}}" for name in ("Good", "Own", "Made")]
    robot.write("demo", "modules:\n" + "\n".join(lines))
    assert preflight(robot.load()).settings.keys() == {"good", "own", "made"}


def test_bug_in_a_class_check_counts_as_failing_code(mapper: Robot) -> None:
    findings = mapper.preflight("mapping.resolution_m=15")
    assert findings.failures["mapping"].endswith("ZeroDivisionError: bug in check\n")
    assert findings.settings == {}


def test_nothing_is_imported_into_the_asking_process(robot: Robot) -> None:
    robot.write_code(
        "mods.who", "import os\nfrom base_of_modules import Plain\nopen('pid', 'w').write(str(os.getpid()))"
    )
    robot.write("demo", "modules: {a: {class: 'mods.who:Plain'}}")
    robot.preflight()
    assert int(Path("pid").read_text()) != os.getpid()


def test_one_process_checks_all_modules_of_a_valid_profile(robot: Robot) -> None:
    robot.write_code(
        "who",
        "import os, base_of_modules\nclass A(base_of_modules.Base):\n"
        "    @classmethod\n    def check(cls, settings): open('pids', 'a').write(f'{os.getpid()}\\n')",
    )
    robot.write("demo", json.dumps({"modules": {f"m{n}": {"class": "who:A"} for n in range(20)}}))
    robot.preflight()
    pids = Path("pids").read_text().split()
    assert len(pids) == 20 and len(set(pids)) == 1


def test_profile_without_modules_needs_no_process(robot: Robot) -> None:
    robot.write("demo", "")
    assert preflight(robot.load()).settings == {}


def test_base_class_that_cannot_be_imported_is_not_an_error_of_the_profile(robot: Robot) -> None:
    robot.write("demo", f"modules: {{a: {PLAIN}}}")
    with pytest.raises(
        PreflightError, match=r"(?s)cannot be checked; nowhere:Base:.*no Python module 'nowhere'"
    ):
        preflight(robot.load(), base_class="nowhere:Base")


def test_by_default_classes_must_be_modules(robot: Robot) -> None:
    robot.write_code(
        "mods.real",
        """
        from robbie_mp import Module, setting
        class Real(Module):
            rate_hz: float = setting(10.0, "how often")
        """,
    )
    robot.write("demo", "modules: {real: {class: 'mods.real:Real'}}")
    assert preflight(robot.load()).settings == {"real": {"rate_hz": 10.0}}
    robot.write("demo", f"modules:\n  plain: {PLAIN}")
    with pytest.raises(ProfileError, match=r"^profiles/demo\.yaml:2: .* not derived from robbie_mp\.Module$"):
        preflight(robot.load())


class ScriptedChecks:
    """Replaces the checking processes: each one returns what the script contains for it."""

    def __init__(self, *rounds: list[dict[str, object]]) -> None:
        self.rounds = list(rounds)
        self.asked: list[list[str]] = []

    def __call__(
        self, _profile: Profile, modules: list[ModuleSpec], _timeout_s: float, _base_class: str
    ) -> Generator[dict[str, object], None, None]:
        self.asked.append([module.name for module in modules])
        yield from self.rounds.pop(0)


SOUND: dict[str, object] = {"result": {"errors": [], "settings": {}, "failure": ""}}


def scripted(monkeypatch: pytest.MonkeyPatch, *rounds: list[dict[str, object]]) -> ScriptedChecks:
    checks = ScriptedChecks(*rounds)
    monkeypatch.setattr("robbie_mp.run.profile.preflight.check_events", checks)
    return checks


def test_crash_between_two_modules_is_attributed_to_neither(monkeypatch: pytest.MonkeyPatch) -> None:
    profile = Profile("made", (ModuleSpec("a", "m:A"), ModuleSpec("b", "n:B")))
    checks = scripted(
        monkeypatch, [{"begin": "a"}, SOUND, {"broken": "ended"}], [{"begin": "b"}, SOUND, {"end": True}]
    )
    findings = preflight(profile)
    assert (findings.settings, findings.failures) == ({"a": {}, "b": {}}, {})
    assert checks.asked == [["a", "b"], ["b"]]


def test_crashed_file_is_not_imported_again_for_another_class(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    profile = Profile("made", (ModuleSpec("a", "m:A"), ModuleSpec("other", "n:C"), ModuleSpec("b", "m:B")))
    checks = scripted(
        monkeypatch, [{"begin": "a"}, {"broken": "hung"}], [{"begin": "other"}, SOUND, {"end": True}]
    )
    assert preflight(profile).failures == dict.fromkeys(["a", "b"], "m: hung while it was imported")
    assert checks.asked == [["a", "other", "b"], ["other"]]


def test_check_process_that_cannot_start_is_a_separate_error(monkeypatch: pytest.MonkeyPatch) -> None:
    scripted(monkeypatch, [{"broken": "ended with exit code 1"}])
    with pytest.raises(PreflightError, match="checks the profile's classes ended with exit code 1"):
        preflight(Profile("made", (ModuleSpec("a", "m:A"),)))


def test_module_that_cannot_import_something_is_an_error_before_the_run(robot: Robot) -> None:
    robot.write_code("mods", "import no_such_library\nclass Camera: pass")
    robot.write(
        "demo", "modules:\n  camera:\n    class: mods:Camera\n  plain:\n    class: base_of_modules:Plain\n"
    )
    with pytest.raises(ProfileError) as caught:
        runnable(robot.load(), robot.preflight())
    assert str(caught.value) == (
        "profiles/demo.yaml:3: modules.camera.class: mods:Camera cannot be imported: ModuleNotFoundError: "
        "No module named 'no_such_library' (mods.py:1); install what is missing, or write `optional: true` "
        "into the module to run without it"
    )


@pytest.mark.parametrize(
    ("library", "extra"),
    [("PIL.Image", "robot"), ("serial", "robot"), ("zenoh", "link"), ("matplotlib", "plot")],
)
def test_missing_library_of_an_extra_names_the_extra(robot: Robot, library: str, extra: str) -> None:
    text = f"No module named '{library}'"
    robot.write_code("mods", f"raise ModuleNotFoundError({text!r}, name={library.partition('.')[0]!r})")
    write_class(robot, "mods:Camera")
    with pytest.raises(ProfileError, match=rf"; install the extra `{extra}`: pip install '.*, or write `opt"):
        runnable(robot.load(), robot.preflight())


def test_run_goes_on_without_an_optional_module_that_cannot_be_imported(robot: Robot) -> None:
    robot.write_code("mods", "import no_such_library\nclass Camera: pass")
    robot.write(
        "demo",
        """
        modules:
          camera: {class: "mods:Camera", optional: true}
          plain: {class: "base_of_modules:Plain", depends_on: [camera]}
        """,
    )
    left = runnable(robot.load(), robot.preflight())
    assert [(module.name, module.depends_on) for module in left.modules] == [("plain", ())]


def test_code_that_fails_otherwise_is_started_and_shown_as_failed(robot: Robot) -> None:
    robot.write_code("mods", "1 / 0")
    robot.write("demo", "modules: {camera: {class: 'mods:Camera'}}")
    assert [module.name for module in runnable(robot.load(), robot.preflight()).modules] == ["camera"]


BRIDGE = "from base_of_modules import Plain\nclass Bridge(Plain): handler_deadline_s = {}"


def test_deadline_of_handlers_is_that_of_the_profile_or_else_of_the_class(robot: Robot) -> None:
    robot.write_code("mods", BRIDGE.format("2.5"))
    robot.write(
        "demo",
        """
        modules:
          plain: {class: "base_of_modules:Plain"}
          bridge: {class: "mods:Bridge"}
          patient: {class: "mods:Bridge", handler_deadline_s: 0}
        """,
    )
    modules = runnable(robot.load(), robot.preflight()).modules
    assert [module.handler_deadline_s for module in modules] == [None, 2.5, 0]


@pytest.mark.parametrize("deadline", ["-1", "'2'", "float('nan')"])
def test_deadline_of_a_class_must_be_one(robot: Robot, deadline: str) -> None:
    robot.write_code("mods", BRIDGE.format(deadline))
    robot.write("demo", "modules: {bridge: {class: 'mods:Bridge'}}")
    with pytest.raises(ProfileError, match=r"demo.yaml:1: .*Bridge.handler_deadline_s is .*; it must be"):
        robot.preflight()


def test_optional_source_of_the_clock_cannot_be_missing(robot: Robot) -> None:
    robot.write_code("mods", "import no_such_library\nclass Camera: pass")
    robot.write("demo", "modules: {time: {class: 'mods:Camera', optional: true}}\nclock: {source: time}")
    with pytest.raises(ProfileError, match=r"demo.yaml:2: clock.source: time cannot be imported"):
        runnable(robot.load(), robot.preflight())


@pytest.mark.parametrize("text", ["", "modules: {}", "variables: {a: 1}"])
def test_profile_without_modules_cannot_run(robot: Robot, text: str) -> None:
    robot.write("demo", text)
    with pytest.raises(ProfileError, match="profile demo has no modules to run; list them under `modules:`"):
        runnable(robot.load(), robot.preflight())


def test_charged_handlers_need_lockstep(robot: Robot) -> None:
    robot.write("demo", "modules: {time: {class: 'mods:Camera'}}\nclock: {source: time, charge: measured}")
    with pytest.raises(ProfileError, match=r"demo.yaml:2: clock.charge: expected clock.lockstep: true"):
        robot.load()


ROS = "class: 'robbie_mp.connect.ros2.module:Ros2Bridge'"


def test_bridge_whose_time_the_run_follows_is_the_source_of_its_clock(robot: Robot) -> None:
    robot.write("demo", f"modules: {{red: {{{ROS}}}}}\nclock: {{follow: ros}}")
    assert robot.load().clock.source == "red"


@pytest.mark.parametrize(
    ("modules", "clock", "problem"),
    [
        (f"red: {{{ROS}}}", "follow: gazebo", "expected ros; got 'gazebo'"),
        ("red: {class: 'mods:Camera'}", "follow: ros", "expected one module of the class .*; there are 0"),
        (f"red: {{{ROS}}}, blue: {{{ROS}}}", "follow: ros", ".*; there are 2"),
        (f"red: {{{ROS}}}", "follow: ros, source: red", "expected neither clock.source nor clock.lockstep"),
    ],
)
def test_clock_that_cannot_be_followed_is_explained(
    robot: Robot, modules: str, clock: str, problem: str
) -> None:
    robot.write("demo", f"modules: {{{modules}}}\nclock: {{{clock}}}")
    with pytest.raises(ProfileError, match=f"demo.yaml:2: clock.follow: {problem}"):
        robot.load()


def test_processors_that_this_machine_lacks_are_refused_before_the_start(robot: Robot) -> None:
    robot.write_code("mods", "from base_of_modules import Base\nclass Camera(Base): pass")
    robot.write("demo", "modules:\n  camera:\n    class: mods:Camera\n    scheduling: {cpus: [100000]}\n")
    with pytest.raises(ProfileError) as caught:
        runnable(robot.load(), robot.preflight())
    assert str(caught.value).startswith(
        "profiles/demo.yaml:4: modules.camera.scheduling.cpus: [100000], of which this machine lets it use no"
    )


def test_processors_to_which_this_process_is_not_bound_may_be_used(robot: Robot) -> None:
    robot.write_code("mods", "from base_of_modules import Base\nclass Camera(Base): pass")
    first, *others = sorted(os.sched_getaffinity(0))
    robot.write("demo", f"modules: {{camera: {{class: 'mods:Camera', scheduling: {{cpus: [{first}]}}}}}}\n")
    try:
        os.sched_setaffinity(0, others or [first])
        assert runnable(robot.load(), robot.preflight()).modules
    finally:
        os.sched_setaffinity(0, [first, *others])
