"""Mistakes of somebody who is new to Robbie-MP: each ends with a line that says where, what, and what to do.

Most are found before anything starts. No mistake shows a traceback.
"""

import re
import shlex
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from robbie_mp import Module, ModuleHarness, Reply, Request, float64
from robbie_mp.cli import main
from robbie_mp.messages import DriveCommand, Image, LaserScan
from robbie_mp.messages.errors import ImmutableMessage, NotAMessage, UnknownField
from robbie_mp.module.class_check import InvalidClass
from robbie_mp.module.deadlines import InvalidDeadline
from robbie_mp.module.handlers import InvalidHandler
from robbie_mp.module.harness import NotSubscribed
from robbie_mp.module.module import InvalidPeriod
from robbie_mp.module.wiring import InvalidTopic
from robbie_mp.run.supervisor.tracebacks import leave_out_our_frames
from tests._support.own_runs import see_own_runs_only

HEAD = "from robbie_mp import *\nfrom robbie_mp.messages import LaserScan\n\n\n"
"""Code begins in line 5."""
CODE = {
    "constructor": (
        "class M(Module):\n    def __init__(self):\n        self.x = 1",
        "6: __init__ is called with the module's context; put what it does into `def setup(self)`",
    ),
    "constructor_alone": (
        "class M(Module):\n    def __init__(self, context):\n        self.x = 1",
        "6: __init__ does not call super().__init__(context); put what it does into `def setup(self)`",
    ),
    "colon": (
        "class M(Module):\n    def tick(self)\n        pass",
        "6: SyntaxError: expected ':' in `def tick(self)`",
    ),
    "indentation": (
        "class M(Module):\n    def tick(self):\n    pass",
        "7: IndentationError: expected an indented block after function definition on line 6 in `pass`",
    ),
    "base": ("class M(Modul): pass", "5: NameError: name 'Modul' is not defined; did you mean 'Module'?"),
    "type_of_setting": (
        "class M(Module):\n    rate: flaot = setting(1.0, 'x')",
        "6: NameError: name 'flaot' is not defined; did you mean 'float'",
    ),
    "setting_without_type": (
        "class M(Module):\n    x = 1\n    rate = setting(1.0, 'x')",
        "7: M.rate needs a type, as in `rate: float = setting(…)`",
    ),
    "hiding_setting": (
        "class M(Module):\n    every: int = setting(1, 'x')",
        "5: the setting every hides Module.every; give it another name",
    ),
    "stock_message": (
        "from robbie_mp.messages import LazerScan\nclass M(Module): pass",
        "5: ImportError: cannot import name 'LazerScan' from 'robbie_mp.messages'; did you mean 'LaserScan'?",
    ),
    "stock_message_of_the_face": (
        "from robbie_mp import Odometry\nclass M(Module): pass",
        "5: ImportError: cannot import name 'Odometry' from 'robbie_mp'; it is a stock message: write "
        "`from robbie_mp.messages import Odometry`",
    ),
    "own_message": (
        "from modules.messages import ProcesorLoad\nclass M(Module): pass",
        "5: ImportError: cannot import name 'ProcesorLoad' from 'modules.messages'; did you mean",
    ),
    "integer": (
        "class S(Message, name='bot/msg/A'):\n    x: int\nclass M(Module): pass",
        "5: DeclarationError: S.x: int has no encoding; say which integer: int8 to int64",
    ),
    "default": (
        "class S(Message, name='bot/msg/D'):\n    x: uint8 = 300\nclass M(Module): pass",
        "5: FieldValueError: bot/msg/D.x: uint8 is 0 to 255, got 300",
    ),
    "two_of_a_name": (
        "class Other(Message, name='bot/msg/ProcessorLoad'):\n    x: float64\nclass M(Module): pass",
        "5: bot/msg/ProcessorLoad: modules.two_of_a_name.Other (version 1) is not "
        "modules.messages.ProcessorLoad (version 1) of that name; give one of them another name",
    ),
    "stock_name": (
        "class Scan(Message, name='sensor_msgs/msg/LaserScan'):\n    x: float64\nclass M(Module): pass",
        "5: sensor_msgs/msg/LaserScan: modules.stock_name.Scan (version 1) is not "
        "robbie_mp.messages.stock.sensor_msgs.LaserScan (version 1) of that name; give one of them another",
    ),
    "async_tick": (
        "class M(Module):\n    period_s = 0.1\n    async def tick(self): pass",
        "7: tick is an `async def`, which would never run; write `def tick`",
    ),
    "async_handler": (
        "class M(Module):\n    def setup(self): self.subscribe(LaserScan, self.on_scan)\n"
        "    async def on_scan(self, scan): pass",
        "6: subscribe: on_scan is an `async def`, which would never run; write `def on_scan`",
    ),
    "no_handler": (
        "class M(Module):\n    def setup(self):\n        self.subscribe(LaserScan, None)",
        "7: subscribe: the handler is None; give a function by its name, without parentheses",
    ),
    "called_handler": (
        "class M(Module):\n    def setup(self): self.subscribe(LaserScan, self.on_scan())\n"
        "    def on_scan(self) -> None: pass",
        "6: subscribe: self.on_scan() calls the handler at once; write self.on_scan, without parentheses",
    ),
    "handler_without_message": (
        "class M(Module):\n    def setup(self): self.subscribe(LaserScan, self.on_scan)\n"
        "    def on_scan(self): pass",
        "6: subscribe: on_scan is called with one argument; write `def on_scan(self, message: LaserScan)`",
    ),
    "misspelled_handler": (
        "class M(Module):\n    def setup(self): self.subscribe(LaserScan, self.on_scna)\n"
        "    def on_scan(self, scan): pass",
        "6: subscribe: M has no method 'on_scna'; did you mean 'on_scan'?",
    ),
    "topic": (
        "class M(Module):\n    period_s = 0.1\n"
        "    def tick(self): self.publish(LaserScan(), topic='my topic!')",
        "7: publish: 'my topic!' is no name of a topic: use letters, digits, _ - . ~ and single slashes, as "
        "in 'my_topic'",
    ),
    "setup": (
        "class M(Module):\n    def setup(self, robot): pass",
        "6: setup is called with no argument; write `def setup(self)`",
    ),
    "setup_of_nothing": (
        "class M(Module):\n    def setup(): pass",
        "6: setup is called with no argument; write",
    ),
    "handler_of_nothing": (
        "class M(Module):\n    def setup(self): self.subscribe(LaserScan, self.on_scan)\n"
        "    def on_scan(): pass",
        "6: subscribe: on_scan is called with one argument; write `def on_scan(self, message: LaserScan)`",
    ),
    "setting_alone": (
        "class M(Module):\n    rate: float = setting(1.0)",
        "6: TypeError: setting() missing 1 required positional argument: 'description'",
    ),
    "text_as_period": (
        "class M(Module):\n    def tick(self): pass\n    period_s = '20ms'",
        "7: M.period_s is '20ms'; it must be greater than 0, at most 1e9, in s, or None for a module that",
    ),
    "topic_first": (
        "class M(Module):\n    period_s = 0.1\n    def tick(self): self.publish('scan', LaserScan())",
        "7: publish: write self.publish(LaserScan(), topic='scan')",
    ),
    "topic_second": (
        "class M(Module):\n    def setup(self): self.subscribe(LaserScan, 'scan', self.on_scan)\n"
        "    def on_scan(self, scan): pass",
        "6: subscribe: write self.subscribe(LaserScan, self.on_scan, topic='scan')",
    ),
    "too_many": (
        "class M(Module):\n    period_s = 0.1\n    def tick(self): self.publish(LaserScan(), 1, latched=1)",
        "7: publish: too many positional arguments; write self.publish(message, topic=…, latched=…)",
    ),
    "unknown_word": (
        "class M(Module):\n    def setup(self): self.every(period=1.0, action=self.steer)\n"
        "    def steer(self): pass",
        "6: every: missing a required argument: 'period_s'; write self.every(period_s, action)",
    ),
    "timer": (
        "class M(Module):\n    def setup(self): self.every(0.1, self.steer)\n    def steer(self, dt): pass",
        "6: every: steer is called with no argument; write `def steer(self)`",
    ),
}
"""By name of the file in modules/: its code below HEAD, and the line that names it."""
LISTED = {
    "no_module": ("modules.lazer:M", "there is no Python module 'modules.lazer'"),
    "no_class": ("modules.load_sensor:LoadSensr", "has no class 'LoadSensr'; did you mean 'LoadSensor'?"),
    "no_heir": (
        "hw.processor:Processor",
        "is not derived from robbie_mp.Module",
    ),
}
"""Classes that a profile names wrongly."""
SENSOR = '{class: "modules.load_sensor:LoadSensor"'
PROFILES = {
    "misspelled": (f"modlues: {{a: {SENSOR}}}}}", "1: modlues: unknown key; did you mean 'modules'?"),
    "indented": ("modules:\n  a:\n    class: x:Y\n   b: 1", "4: YAML: .*; indent all keys of a map alike"),
    "colon": ("description: a: b", "1: YAML: .*; quote a text with a colon in it, or check the indentation"),
    "clock": (f"modules: {{a: {SENSOR}}}}}\nclock: {{source: tme}}", "2: .*: there is no module 'tme'"),
    "value": (
        f"modules:\n  a: {SENSOR}, settings: {{period_s: fast}}}}",
        "2: modules.a.settings.*: LoadSensor.period_s: expected float, at least 0.01, or with its unit, "
        "as in 20ms; got 'fast' (str)",
    ),
}  # fmt: skip
"""By name of the profile: its text, and the line that names it."""
COMMANDS = {
    "clean ''": (2, "robbie clean: argument folder: the path is empty; see `robbie clean --help`"),
    "log --last -1": (2, "argument --last: expected a whole number from 0; got '-1'"),
    "log --last 1_0": (2, "argument --last: expected a whole number from 0; got '1_0'"),
    "replay x --limit nan": (2, "argument --limit: expected a time such as"),
    "replay x --debug 99999": (2, "argument --debug: expected a whole number from 1 to 65535; got '99999'"),
    "pub LaserScan --count 0": (2, "argument --count: expected a whole number from 1; got '0'"),
    "rnu": (2, "'rnu' is no command; did you mean 'run'?"),
    "run": (2, "robbie run: the following arguments are required: profile; see `robbie run --help`"),
    "run robt": (2, "there is no profile 'robt'; did you mean 'robot'?"),
    "run robot.yaml": (2, "there is no file robot.yaml; did you mean `robbie run robot`?"),
    "run profiles/robot": (2, "there is no profile 'profiles/robot'; did you mean 'robot'?"),
    "run profiles/robot.yml": (2, "there is no profile 'profiles/robot.yml'; did you mean 'robot'?"),
    "run folder": (2, "there is no profile 'folder'; did you mean 'code'?"),
    "run robot --witout sensor": (2, "arguments: --witout sensor; did you mean '--without'"),
    "run robot --set nope=1": (2, "--set nope: expected MODULE.SETTING=VALUE"),
    "run robot --set sensr.period_s=1": (2, "--set sensr.*: there is no module 'sensr'"),
    "run robot --set sensor.period_s=fast": (2, "--set sensor.period_s: .*expected float, at least 0.01"),
    "run robot --without nosuch": (2, "--without nosuch: there is no module 'nosuch'; modules: sensor"),
    "run robot --only nosuch": (2, "--only nosuch: there is no module 'nosuch'; modules: sensor"),
    "run nosuch:Sensor": (2, "nosuch:Sensor: modules.sensor.class: there is no Python module 'nosuch'"),
    "run robot --var x=1": (2, "--var x: there is no variable 'x'; .*declare it under `variables:`"),
    "echo scan": (1, "no run.*; start one with `robbie run PROFILE`"),
    "stop": (1, "no run.*; start one with `robbie run PROFILE`"),
    "info nofile.mcap": (2, "nofile.mcap cannot be read: No such file or directory"),
    "info notes.txt": (2, "notes.txt is none of the files that can be described: logs (MCAP"),
    "play nofile.mcap": (2, "expected path of an existing file or folder; there is no .*nofile.mcap"),
    "play notes.txt robot": (2, "a profile that plays recordings has `parents: [robbie:playback]`"),
    "export notes.txt out": (2, "notes.txt is no MCAP file"),
    "new .": (1, ". is not empty; name an empty folder or one that does not exist"),
    "top --nosuch": (2, "unrecognized arguments: --nosuch; see `robbie top --help`"),
    "export a b --nosuch": (2, "unrecognized arguments: --nosuch; see `robbie export --help`"),
    "param set a.b 1 --nosuch": (2, "unrecognized arguments: --nosuch; see `robbie param set --help`"),
    "run modules/load_sensor.py": (
        2,
        "modules/load_sensor.py is code, no profile; write `robbie run modules.load_sensor:LoadSensor`",
    ),
    "run notes.txt": (
        2,
        "notes.txt is no profile, which is a file profiles/NAME.yaml; write `robbie run NAME`",
    ),
    "run robot --only black_box": (2, "there is no module 'black_box' in the profile: it runs beside those"),
}
"""By the words of the command: its exit code, and the line."""


def pattern(line: str) -> str:
    """A regular expression for a line, in which `.*` stands for anything."""
    return ".*".join(map(re.escape, line.split(".*")))


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The new workspace of a beginner, with all mistakes."""
    folder = tmp_path_factory.mktemp("mistakes") / "bot"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder.parent)
        assert main(["new", "bot"]) == 0
    (folder / "notes.txt").write_text("hello\n")
    (folder / "profiles" / "folder.yaml").mkdir()
    for name, (code, _) in CODE.items():
        (folder / "modules" / f"{name}.py").write_text(f"{HEAD}{code}\n")
    classes = {name: f"modules.{name}:M" for name in CODE} | {
        name: path for name, (path, _) in LISTED.items()
    }
    lines = [f"  {name}: {{class: '{path}'}}\n" for name, path in classes.items()]
    (folder / "profiles" / "code.yaml").write_text(f"modules:\n  sensor: {SENSOR}}}\n{''.join(lines)}")
    for name, (text, _) in PROFILES.items():
        (folder / "profiles" / f"{name}.yaml").write_text(f"{text}\n")
    return folder


class Ended(NamedTuple):
    """What a command did."""

    code: int
    lines: list[str]


@pytest.fixture
def command(
    workspace: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., Ended]:
    """Runs `robbie` in the workspace."""
    monkeypatch.chdir(workspace)
    see_own_runs_only()
    (tmp_path / "runtime").mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))

    def run(*words: str) -> Ended:
        try:
            code = main(words)
        except SystemExit as end:
            code = int(end.code or 0)
        output = capsys.readouterr().err
        assert "Traceback" not in output
        return Ended(code, output.splitlines())

    return run


def test_mistakes_in_code_are_found_before_the_start_each_with_its_line(
    command: Callable[..., Ended],
) -> None:
    ended = command("run", "code")
    assert ended.code == 2
    said = "\n".join(ended.lines)
    missing = [
        name
        for name, (_, line) in CODE.items()
        if not re.search(f"^modules/{name}.py:{pattern(line)}", said, re.MULTILINE)
    ]
    assert not missing, said
    for name, (_, line) in LISTED.items():
        assert re.search(
            rf"^profiles/code.yaml:\d+: modules.{name}.class: .*{pattern(line)}", said, re.MULTILINE
        )
    assert len(ended.lines) == len(CODE) + len(LISTED), said


@pytest.mark.parametrize("name", PROFILES)
def test_mistake_in_a_profile_is_named_with_its_line(command: Callable[..., Ended], name: str) -> None:
    ended = command("run", name)
    line = f"profiles/{name}.yaml:{PROFILES[name][1]}"
    assert any(re.match(pattern(line), one) for one in ended.lines), ended.lines
    assert ended.code == 2 and len(ended.lines) < 3


@pytest.mark.parametrize("words", COMMANDS)
def test_mistake_on_the_command_line_says_what_to_write(command: Callable[..., Ended], words: str) -> None:
    code, line = COMMANDS[words]
    ended = command(*shlex.split(words))
    assert re.search(pattern(line), ended.lines[-1]), ended.lines
    assert ended.code == code and len(ended.lines) == 1


def test_missing_library_is_named_with_the_line_that_imports_it(command: Callable[..., Ended]) -> None:
    Path("modules/needy.py").write_text(f"{HEAD}import numppy\nclass M(Module): pass\n")
    Path("profiles/needy.yaml").write_text("modules:\n  a: {class: 'modules.needy:M'}\n")
    ended = command("run", "needy")
    assert ended.lines == [
        "profiles/needy.yaml:2: modules.a.class: modules.needy:M cannot be imported: ModuleNotFoundError: "
        "No module named 'numppy' (modules/needy.py:5); install what is missing, or write `optional: true` "
        "into the module to run without it"
    ]


class Camera(Module):
    """Does what a test wants."""

    def on_scan(self, _scan: LaserScan) -> None:
        pass


def kept(module: Any) -> None:
    with module.loan(Image, data=4) as image:
        pixels = image.data
    pixels[0] = 1


WHILE_IT_RUNS: dict[str, tuple[Callable[[Any], object], type[Exception], str]] = {
    "publish a dict": (
        lambda module: module.publish({"ranges": [1.0]}),
        NotAMessage,
        "publish wants a message",
    ),
    "wrong field": (
        lambda _: LaserScan(range=[1.0]),  # type: ignore[call-arg]
        UnknownField,
        "LaserScan() got an unexpected keyword argument 'range'; did you mean 'ranges'",
    ),
    "set a wrong field": (
        lambda _: setattr(LaserScan(), "range", [1.0]),
        ImmutableMessage,
        "LaserScan is immutable, and has no field 'range'; did you mean 'ranges'",
    ),
    "set a field": (
        lambda _: setattr(LaserScan(), "ranges", [1.0]),
        ImmutableMessage,
        "LaserScan is immutable; create a copy with another ranges: see replace()",
    ),
    "handler of a lambda": (
        lambda module: module.subscribe(LaserScan, lambda: None),
        InvalidHandler,
        "is called with one argument",
    ),
    "topic of a variable": (
        lambda module: module.publish(LaserScan(), topic=f"laser {1}"),
        InvalidTopic,
        "as in 'laser_1'",
    ),
    "topic None": (
        lambda module: module.publish(LaserScan(), topic=None),
        InvalidTopic,
        "leave it out for messages without a topic",
    ),
    "deadline of nothing": (
        lambda module: module.subscribe(LaserScan, module.on_scan, deadline_s=0),
        InvalidDeadline,
        "deadline_s is 0; give a time greater than 0, at most 1e9, in s",
    ),
    "write to a loan that has ended": (kept, ValueError, "read-only"),
}
"""What a module does wrong while it runs: its error, and what the line says."""


@pytest.mark.parametrize("name", WHILE_IT_RUNS)
def test_mistake_while_a_module_runs_is_explained(name: str) -> None:
    do, error, line = WHILE_IT_RUNS[name]
    with ModuleHarness(Camera) as harness, pytest.raises(error, match=pattern(line)) as raised:
        do(harness.module)
    assert "\n" not in str(raised.value)
    leave_out_our_frames(raised.value)
    assert {frame.filename for frame in traceback.extract_tb(raised.value.__traceback__)} == {__file__}


def test_error_of_ours_that_no_line_of_the_module_raised_has_no_traceback() -> None:
    class Ticks(Module):
        def setup(self) -> None:
            self.period_s = 0

    with pytest.raises(InvalidPeriod) as raised, ModuleHarness(Ticks):
        pass
    frames = raised.value.__traceback__
    assert frames
    raised.value.__traceback__ = frames.tb_next  # without this test
    leave_out_our_frames(raised.value)
    assert raised.value.__traceback__ is None


class Seen(Reply, name="bot/srv/Look_Response"):
    range_m: float64


class Look(Request[Seen], name="bot/srv/Look_Request"):
    pass


class Listens(Module):
    def setup(self) -> None:
        self.serve(Look, lambda _look: Seen(range_m=1.0))
        self.subscribe(LaserScan, self.on_scan, topic="scan")

    def on_scan(self, _scan: LaserScan) -> None:
        pass


SENT: dict[str, tuple[Any, str, type[Exception], str]] = {
    "nothing": (None, "scan", NotAMessage, "send wants a message, such as LaserScan(ranges=...); got None"),
    "a class": (LaserScan, "scan", NotAMessage, "create a message: send(LaserScan(...))"),
    "misspelled topic": (
        LaserScan(),
        "scna",
        NotSubscribed,
        "Listens takes no sensor_msgs/msg/LaserScan on topic 'scna'; did you mean 'scan'?",
    ),
    "no topic": (LaserScan(), "", NotSubscribed, "LaserScan on topic ''; it takes it on 'scan'"),
    "request": (Look(), "", NotSubscribed, "on topic ''; it is part of a call, so send it with call()"),
    "other type": (DriveCommand(), "scan", NotSubscribed, "it does not subscribe to this type"),
}
"""What a test sends a module wrongly, and on which topic: the error, and what the line says."""


@pytest.mark.parametrize("name", SENT)
def test_message_that_no_handler_gets_fails_the_test(name: str) -> None:
    message, topic, error, line = SENT[name]
    with ModuleHarness(Listens) as harness, pytest.raises(error, match=pattern(line)) as raised:
        harness.send(message, topic=topic)
    assert "\n" not in str(raised.value)


def test_tick_without_a_period_is_explained() -> None:
    class Ticking(Module):
        def tick(self) -> None:
            pass

    with pytest.raises(InvalidClass, match=r"write `period_s = 0\.1` in the class"):
        ModuleHarness(Ticking)
