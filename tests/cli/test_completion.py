"""Completion in bash, and properties of the whole command line."""

import argparse
import os
import pty
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.cli import main
from robbie_mp.cli.new import make_workspace
from robbie_mp.cli.program import GROUPS, parser_of
from tests._support.robot import COMMAND

ASK = """
eval "$(robbie completion bash)"
COMP_LINE="$1" COMP_POINT=${#1} COMP_TYPE=9
COMP_WORDS=($1) COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
_python_argcomplete robbie
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def robbie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A workspace, and `robbie` on the path."""
    program = tmp_path / "bin" / "robbie"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {shlex.join(COMMAND)} "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    make_workspace(tmp_path / "mouse")
    with open(tmp_path / "mouse" / "profiles" / "robot.yaml", "a") as profile:
        profile.write("variables: {simulated: true}\n")
    monkeypatch.chdir(tmp_path / "mouse")
    return tmp_path / "mouse"


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("robbie ec", {"echo"}),
        ("robbie run robo", {"robot"}),
        (
            "robbie run robbie:resc",
            {
                "rescue",
                "rescue-emulated",
                "rescue-fast",
                "rescue-ros1",
                "rescue-small",
                "rescue-team",
                "rescue-team-fast",
            },
        ),
        ("robbie pub --ra", {"--rate"}),
        ("robbie recording cu", {"cut"}),
        ("robbie log --fol", {"--follow"}),
        ("robbie run robot --without s", {"sensor"}),
        ("robbie run robot --var si", {"simulated="}),
    ],
)
def test_bash_completion_works(robbie: Path, typed: str, offered: set[str]) -> None:
    asked = subprocess.run(
        ["bash", "-c", ASK, "bash", typed], capture_output=True, text=True, timeout=60, check=True
    )
    assert {word.strip() for word in asked.stdout.split("\n")} - {""} == offered, asked.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_script_for_each_shell_names_the_program(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    assert "robbie" in capsys.readouterr().out


def leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """All commands without subcommands."""
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    if not actions:
        yield parser
    for action in actions:
        for command in action.choices.values():
            yield from leaves(command)


@pytest.mark.parametrize("command", tuple(leaves(parser_of(()))), ids=lambda command: command.prog)
def test_help_of_every_command_has_examples(command: argparse.ArgumentParser) -> None:
    shown = command.format_help()
    assert re.search(rf"^examples:\n  .*{command.prog}\b", shown, re.MULTILINE), shown


def test_robbie_alone_prints_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    shown = capsys.readouterr().out
    for group, names in GROUPS.items():
        assert re.search(rf"^  {re.escape(group)}:$", shown, re.MULTILINE)
        assert all(re.search(rf"^    {name}( |$)", shown, re.MULTILINE) for name in names), names
    assert max(map(len, shown.splitlines())) <= 80


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        (["ehco", "Image"], "robbie: 'ehco' is no command; did you mean 'echo' or 'record'?; see"),
        (["module", "strat", "x"], "robbie module: 'strat' is no action; did you mean 'start' or 'restart'?"),
        (["list", "topisc"], "robbie list: 'topisc' is no possible choice; did you mean 'topics'?"),
        (["zzz"], "robbie: 'zzz' is no command; there are run, stop, module"),
    ],
)
def test_mistyped_command_gets_a_suggestion(
    typed: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(typed)
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith(said)
    assert error.count("\n") == 1


def test_usage_error_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["echo"])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert said == "robbie echo: the following arguments are required: TYPE|TOPIC; see `robbie echo --help`\n"


def test_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith("robbie ")


def test_commands_are_loaded_one_by_one() -> None:
    choices = parser_of(["echo"])._subparsers._group_actions[0].choices  # type: ignore[union-attr]
    assert choices is not None
    assert list(choices) == ["echo"]


@pytest.mark.parametrize("variable", ["NO_COLOR", "NOTHING"])
def test_no_color_is_respected_on_a_terminal(robbie: Path, variable: str) -> None:
    terminal, end = pty.openpty()
    environment = {**os.environ, variable: "1", "TERM": "xterm-256color"}
    with os.fdopen(end, "wb") as output:
        subprocess.run(["robbie", "doctor"], stdout=output, env=environment, timeout=60, check=False)
    shown = os.read(terminal, 1 << 16).decode()
    os.close(terminal)
    assert shown
    assert (re.search("\x1b\\[[0-9;]*3[0-9]", shown) is None) == (variable == "NO_COLOR")


CHANGING = {
    "attach", "stop", "module", "pub", "param set", "param dump", "param load", "record", "recording",
    "export", "import-carmen", "import-rosbag", "new", "install", "keys new", "keys trust", "keys revoke",
    "keys check", "completion", "playback keys", "plot", "report", "type import",
}  # fmt: skip
"""Commands that do something, rather than list or show it, or that draw."""


@pytest.mark.parametrize("command", tuple(leaves(parser_of(()))), ids=lambda command: command.prog)
def test_every_command_that_lists_or_shows_something_has_json(command: argparse.ArgumentParser) -> None:
    _, *words = command.prog.split()
    does = {words[0], " ".join(words)} & CHANGING
    assert bool(does) is not ("--json" in command._option_string_actions)
