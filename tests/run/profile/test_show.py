"""`robbie profile show` prints the profile, with the origin of each value."""

import json
import os
import subprocess
import sys
from functools import partial

import pytest

import robbie_mp.cli.profile
from robbie_mp.cli import main
from robbie_mp.run.profile.preflight import preflight
from robbie_mp.run.profile.show import as_tree
from tests.run.profile.conftest import BASE_CLASS, Robot

Out = pytest.CaptureFixture[str]

CODE = """
from pathlib import Path
from base_of_modules import Base
from robbie_mp import setting
class Mapping(Base):
    resolution_m: float = setting(0.05, "edge of a grid cell", minimum=0)
    names: list[str] = setting(["no"], "names")
    weights: dict[str, float] = setting({"x": 1.0}, "weights")
"""


@pytest.fixture(autouse=True)
def profiles(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robbie_mp.cli.profile, "preflight", partial(preflight, base_class=BASE_CLASS))
    robot.write_code("mapping", CODE)
    robot.write(
        "base",
        """
        description: "Ä: #1"
        modules:
          mapping:
            class: mapping:Mapping
            settings: {resolution_m: 1e-3, weights: {y: 2}}
        variables: {radius_m: 0.25, port: "1e5"}
        """,
    )
    robot.write("demo", "parents: [base]\nmodules:\n  mapping:\n    restart:\n      max_restarts: 1")


def comment_of(output: str) -> dict[str, str]:
    """Return the comment behind each line, by what stands before it."""
    lines = [line.partition("  # ") for line in output.splitlines()]
    return {text.strip(): comment for text, _, comment in lines}


def test_each_value_is_shown_with_its_origin(capsys: Out) -> None:
    assert main(["profile", "show", "demo", "--set", "mapping.resolution_m=0.3"]) == 0
    comments = comment_of(capsys.readouterr().out)
    assert comments["class: mapping:Mapping"] == "profiles/base.yaml:5"
    assert comments["y: 2.0"] == "profiles/base.yaml:6"
    assert comments["names: ['no']"] == "default"
    assert comments["max_restarts: 1"] == "profiles/demo.yaml:5"
    assert comments["policy: on-failure"] == "default"
    assert comments["resolution_m: 0.3"] == "--set mapping.resolution_m"
    assert comments["handles: 16384"] == "default"


def test_shown_profile_is_an_equal_profile(robot: Robot, capsys: Out) -> None:
    assert main(["profile", "show", "demo"]) == 0
    shown = capsys.readouterr().out
    robot.write("again", shown)
    before, after = robot.load("demo"), robot.load("again")
    assert after.modules[0].settings == {
        "resolution_m": 0.001,
        "names": ["no"],
        "weights": {"y": 2.0},
    }
    assert (after.variables, after.core, after.description) == (
        before.variables,
        before.core,
        before.description,
    )
    assert after.modules[0].restart == before.modules[0].restart
    assert main(["profile", "show", "again"]) == 0
    assert comment_of(capsys.readouterr().out).keys() - {"# profile again"} == comment_of(shown).keys() - {
        "# profile demo"
    }


def test_json_output_is_complete(robot: Robot, capsys: Out) -> None:
    assert main(["profile", "show", "demo", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["name"], shown["workspace"]) == ("demo", str(robot.root))
    assert shown["modules"]["mapping"]["settings"]["names"] == ["no"]
    assert shown["origins"]["modules/mapping/settings/names"] == "default"
    assert shown["origins"]["variables/radius_m"] == "profiles/base.yaml:7"


def test_wrong_profile_is_exit_code_2_and_text_on_stderr(robot: Robot, capsys: Out) -> None:
    robot.write("demo", "modlues: {}\ncore: 5")
    assert main(["profile", "show", "demo"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err == (
        "profiles/demo.yaml:1: modlues: unknown key; did you mean 'modules'?\n"
        "profiles/demo.yaml:2: core: expected a map; got 5\n"
    )


def test_wrong_setting_is_exit_code_2_too(capsys: Out) -> None:
    assert main(["profile", "show", "demo", "--set", "mapping.resolution_m=-1"]) == 2
    assert "Mapping.resolution_m: expected float, at least 0; got -1.0 (float)" in capsys.readouterr().err


def test_code_that_cannot_be_imported_is_a_warning(robot: Robot, capsys: Out) -> None:
    robot.write_code("mapping", "raise OSError('no lens')")
    assert main(["profile", "show", "demo"]) == 0
    out, err = capsys.readouterr()
    assert err == "warning: module mapping cannot be imported: OSError: no lens (mapping.py:1)\n"
    assert "resolution_m: 0.001" in out


def test_tree_of_an_unchecked_profile_is_that_of_its_files(robot: Robot) -> None:
    tree = as_tree(robot.load(), {})
    assert tree["modules"]["mapping"]["settings"] == {"resolution_m": 0.001, "weights": {"y": 2}}
    sections = ["core", "spares", "trace", "tools", "black_box"]
    assert list(tree) == ["description", "variables", "modules", *sections]


@pytest.mark.parametrize(
    "argv", [["profile"], ["profile", "show"], ["nonsense"], ["profile", "show", "a", "-x"]]
)
def test_bad_usage_is_exit_code_2(argv: list[str], capsys: Out) -> None:
    with pytest.raises(SystemExit) as ended:
        main(argv)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("robbie")
    assert said.count("\n") == 1, "one line for each error"


def test_help_and_version_are_printed(capsys: Out) -> None:
    # Twice: a command that is imported must not get in the way of the program.
    for option, text in [
        ("--help", "show what"),
        ("--help", "show a profile merged with its parents"),
        ("--version", "robbie "),
    ]:
        with pytest.raises(SystemExit) as ended:
            main([option])
        assert ended.value.code == 0
        assert text in capsys.readouterr().out


def test_colour_only_on_a_terminal(robot: Robot) -> None:
    robot.write("plain", "variables: {a: 1}")
    run = "import sys; from robbie_mp.cli import main; sys.exit(main(['profile', 'show', 'plain']))"
    environment = {name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "COLUMNS")}
    environment |= {"PYTHONPATH": ":".join(sys.path), "TERM": "xterm-256color"}
    piped = subprocess.run([sys.executable, "-c", run], env=environment, stdout=subprocess.PIPE, check=True)
    assert b"\x1b" not in piped.stdout
    controller, terminal = os.openpty()
    try:
        subprocess.run([sys.executable, "-c", run], env=environment, stdout=terminal, check=True)
        shown = os.read(controller, 65536)
    finally:
        os.close(terminal)
        os.close(controller)
    assert b"\x1b[2m" in shown and b"profiles/plain.yaml:1" in shown


@pytest.mark.slow
@pytest.mark.every_turn
def test_closed_output_causes_no_traceback(robot: Robot) -> None:
    robot.write("long", "variables:\n" + "".join(f"  key{n}: {'x' * 2000}\n" for n in range(100)))
    run = "import sys; from robbie_mp.cli import main; sys.exit(main(['profile', 'show', 'long']))"
    process = subprocess.Popen(
        [sys.executable, "-c", run],
        env=os.environ | {"PYTHONPATH": ":".join(sys.path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout and process.stderr
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    process.wait()
