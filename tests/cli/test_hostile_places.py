"""Every command in places that harm it: one clear line, an exit code that says so, no traceback, no hang."""

import argparse
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.cli.program import parser_of
from tests.docs._support.pages import ROOT
from tests.logs.recording._support.logs import write_log
from tests.logs.recording.test_imports import CARMEN, write_bag

pytestmark = pytest.mark.slow

OUTPUTS = {"folder", "target", "output", "root", "layout", "keys"}
"""Arguments that name something to be written."""
INPUTS = {"log", "logs", "a", "b", "file", "source", "directory", "profile"}
VALUES = {
    "what": "messages",
    "value": "1",
    "messages": "String",
    "message": "{data: x}",
    "robot": "127.0.0.1:9",
}
SOURCES = {
    "import-carmen": "good.clf",
    "import-rosbag": "good.bag",
    "keys trust": "good.key",
    "param load": "good.yaml",
}
PROFILE = "modules:\n  logger: {class: robbie_mp.logs.message_logger:MessageLogger}\n"
SERVERS = {"run", "play", "gui", "foxglove", "connect"}
"""Commands that go on until they are told to end."""
SERVER_S, COMMAND_S = 3.0, 40.0


def leaves(parser: argparse.ArgumentParser, words: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    groups = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for group in groups:
        for name, command in group.choices.items():
            yield from leaves(command, (*words, name))
    if not groups:
        yield " ".join(words), parser


COMMANDS = dict(leaves(parser_of(())))


class Place:
    """A folder with good inputs, and commands that use them or something bad in their place."""

    def __init__(self, folder: Path):
        self.folder = folder
        write_log(folder / "good.mcap", 30)
        (folder / "good.clf").write_text(CARMEN.replace("FLASER broken\n", ""))
        (folder / "good.yaml").write_text("{}\n")
        (folder / "profiles").mkdir()
        (folder / "profiles" / "profile.yaml").write_text(PROFILE)
        write_bag(folder, "ROS 1").rename(folder / "good.bag")

    def command(
        self, name: str, *, bad_input: Path | None = None, bad_output: Path | None = None
    ) -> list[str]:
        """Return a command line with a good or bad value for each argument that a command needs."""
        words = name.split()
        for action in COMMANDS[name]._actions:
            value = self._value(name, action, bad_input, bad_output)
            if value and not action.option_strings:
                words.append(value)
            elif value and (action.required or action.dest in OUTPUTS):
                words += [action.option_strings[-1], value]
        return words

    def commands(self) -> dict[str, list[str]]:
        """Return a good command line of every command."""
        return {name: self.command(name) for name in COMMANDS}

    def _value(self, name: str, action: Any, bad_input: Path | None, bad_output: Path | None) -> str:
        if action.dest in OUTPUTS:
            return str(bad_output or "made-" + name.replace(" ", "-"))
        if action.dest in INPUTS and not action.option_strings:
            good = "profiles/profile.yaml" if action.dest == "profile" else SOURCES.get(name, "good.mcap")
            return str(bad_input or self.folder / good)
        if action.choices:
            return str(next(iter(action.choices)))
        return VALUES.get(action.dest, "thing.part" if action.dest == "setting" else "thing")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    return Place(tmp_path_factory.mktemp("place"))


def done(
    place: Place,
    commands: dict[str, list[str]],
    *,
    folder: Path | None = None,
    gone: bool = False,
    output: str = "file",
    environment: dict[str, str | None] | None = None,
    shell: str = "",
) -> dict[str, dict[str, Any]]:
    """Run commands without the power to read and write everything; return what each did."""
    case = {
        "folder": str(folder or place.folder),
        "gone": gone,
        "output": output,
        "environment": environment or {},
    }
    cases = [
        case | {"command": words, "patience_s": SERVER_S if name in SERVERS else COMMAND_S}
        for name, words in commands.items()
    ]
    runner = [sys.executable, "-m", "tests.cli._support.command_runner"]
    if os.geteuid() == 0:
        runner = ["setpriv", "--bounding-set=-dac_override,-dac_read_search", *runner]
    if shell:
        runner = ["unshare", "--map-root-user", "--mount", "sh", "-ec", f'{shell}\nexec "$@"', "sh", *runner]
    ended = subprocess.run(
        runner, cwd=ROOT, input=json.dumps(cases), capture_output=True, text=True, check=False, timeout=110
    )
    assert ended.returncode == 0, ended.stderr
    return dict(zip(commands, json.loads(ended.stdout), strict=True))


def faults(results: dict[str, dict[str, Any]]) -> list[str]:
    """Say what is wrong with how commands ended."""
    return [f"{name}: {fault}" for name, one in results.items() for fault in _faults(name, one)]


def _faults(name: str, one: dict[str, Any]) -> Iterator[str]:
    if "Traceback" in one["errors"] or "Exception ignored" in one["errors"]:
        yield one["errors"]
    if one["told"] and name not in SERVERS:
        yield f"did not end: {one}"
    if one["code"] not in (0, 1, 2, *((130, -signal.SIGINT) if one["told"] else ())):
        yield f"ended with {one['code']}: {one}"
    if one["code"] in (1, 2) and not one["errors"] and not one["output"]:
        yield f"failed without a word: {one}"


def third(commands: dict[str, list[str]], first: int) -> dict[str, list[str]]:
    """Return `run` and every third command from `first` on: all of them in every place would take minutes."""
    return {
        name: words for at, (name, words) in enumerate(commands.items()) if at % 3 == first or name == "run"
    }


HELP = {f"{name} --help": [*name.split(), "--help"] for name in ("info", "recording cut")}


@pytest.fixture(scope="module")
def well(place: Place, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """What commands do where all is well."""
    return done(place, place.commands() | HELP, folder=tmp_path_factory.mktemp("well"))


def test_every_command_ends_well_where_all_is_well(well: dict[str, dict[str, Any]]) -> None:
    assert not faults(well)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("first", "output"), [(0, "full"), (1, "closed"), (2, "broken")])
def test_output_that_cannot_be_written_is_a_failure(
    place: Place, well: dict[str, dict[str, Any]], tmp_path: Path, first: int, output: str
) -> None:
    ill = done(place, third(place.commands() | HELP, first), folder=tmp_path, output=output)
    assert not [one for one in faults(ill) if output != "broken" or "without a word" not in one]
    prints = [name for name in ill if well[name]["output"]]
    assert len(prints) > 3
    assert not [name for name in prints if ill[name]["code"] == 0]
    assert ill["run"]["told"]  # a robot does not stop because nobody can read its output


def test_deleted_working_directory(place: Place, tmp_path: Path) -> None:
    assert not faults(done(place, third(place.commands(), 0), folder=tmp_path, gone=True))


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("first", "home"), [(1, None), (2, "/proc/none")])
def test_home_that_is_unset_or_cannot_be_written(
    place: Place, tmp_path: Path, first: int, home: str | None
) -> None:
    environment = {"HOME": home, "XDG_CONFIG_HOME": None}
    assert not faults(done(place, third(place.commands(), first), folder=tmp_path, environment=environment))


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("kind", "use"),
    [*((kind, "bad_input") for kind in ("directory", "fifo", "unreadable")), ("fifo", "bad_output")],
)
def test_what_is_no_file_in_place_of_a_file(place: Place, tmp_path: Path, kind: str, use: str) -> None:
    bad = tmp_path / "bad"
    if kind == "fifo":
        os.mkfifo(bad)
    elif kind == "directory":
        bad.mkdir()
    else:
        bad.write_bytes((place.folder / "good.mcap").read_bytes())
        bad.chmod(0)
    folder = tmp_path / "here"
    folder.mkdir()
    commands = {name: place.command(name, **{use: bad}) for name in COMMANDS}
    changed = {name: words for name, words in commands.items() if str(bad) in words}
    results = done(place, changed, folder=folder)
    assert not faults(results)
    if use == "bad_input":
        assert not [name for name, one in results.items() if one["code"] == 0 and name != "log"]


READ_ONLY = 'mount -t tmpfs -o ro none "{}"'


@pytest.fixture(scope="module")
def can_mount(tmp_path_factory: pytest.TempPathFactory) -> None:
    at = tmp_path_factory.mktemp("mount")
    command = ["unshare", "--map-root-user", "--mount", "sh", "-ec", READ_ONLY.format(at)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("NOT TESTED, this machine allows no mounts of one's own")


@pytest.mark.usefixtures("can_mount")
def test_read_only_file_system(place: Place, tmp_path: Path) -> None:
    environment: dict[str, str | None] = {"HOME": str(tmp_path), "XDG_CONFIG_HOME": None}
    shell = READ_ONLY.format(tmp_path)
    commands = third(place.commands(), 0)
    assert not faults(done(place, commands, folder=tmp_path, environment=environment, shell=shell))


@pytest.mark.usefixtures("can_mount")
def test_shared_memory_that_cannot_be_written(place: Place, tmp_path: Path) -> None:
    assert not faults(
        done(place, third(place.commands(), 1), folder=tmp_path, shell=READ_ONLY.format("/dev/shm"))
    )
