"""The wheel is complete: installed alone into an empty environment, outside any checkout."""

import json
import os
import re
import signal
import subprocess
import sys
import sysconfig
import venv
import wave
from collections.abc import Sequence
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import pytest

from robbie_mp.cli.new import EXTRAS
from robbie_mp.cli.runs import live_runs
from robbie_mp.run.control import SOCKET_NAME
from tests._support.robot import wait_until
from tests._support.sources import copy_sources

pytestmark = pytest.mark.slow

LIMIT_S = 150.0
USER_CODE = """
from robbie_mp import Module, setting
from robbie_robots.hw.rplidar.laser import RpLidar
from robbie_robots.modules.maps.mapping import Mapping
from robbie_robots.workers.exploration.explorer import Explorer


class Mine(Module):
    period_s: float = setting(0.1, "time between looks")
    laser: RpLidar
    explorer: Explorer

    def tick(self) -> None: ...


def range_m(mapping: Mapping) -> str:
    return mapping.max_range_m
"""
USER_PROFILE = """
parents: [robbie:parts/rescue-robot]
modules:
  mine: {class: "modules.mine:Mine"}
  laser: {class: "robbie_robots.modules.devices.rplidar:RpLidarRangeFinder", settings: {port: /dev/ttyUSB0}}
"""


def run(*command: str | Path, cwd: Path) -> str:
    """Run a command with nothing of this environment, and return what it prints."""
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        timeout=LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{command}\n{done.stdout}"
    return done.stdout


def required(distribution_name: str, found: dict[str, Distribution] | None = None) -> dict[str, Distribution]:
    """What a distribution needs, and what that needs, and so on; extras left out."""
    found = {} if found is None else found
    for line in distribution(distribution_name).requires or []:
        requirement, _, condition = line.partition(";")
        name = re.match(r"[\w.-]+", requirement)
        if name and name[0] not in found and not condition and is_installed(name[0]):
            found[name[0]] = distribution(name[0])
            required(name[0], found)
    return found


def is_installed(name: str) -> bool:
    try:
        distribution(name)
    except PackageNotFoundError:
        return False
    return True


def link_what_the_wheel_needs(site: Path, extras: Sequence[str] = ()) -> None:
    """Make what the wheel says it needs, and nothing else, importable: no network is asked for it.

    What is not installed here either is left out; a robot that needs it says so.

    Args:
        site: where the wheel is installed.
        extras: those whose packages are linked, too.
    """
    for name in filter(is_installed, required_by_wheel(site, extras)):
        for needed in {name: distribution(name), **required(name)}.values():
            for file in needed.files or []:
                top = file.parts[0]
                if top not in ("..", "__pycache__") and not (site / top).exists():
                    (site / top).symlink_to(str(needed.locate_file(top)))


def required_by_wheel(site: Path, extras: Sequence[str]) -> list[str]:
    (metadata,) = site.glob("robbie_mp-*.dist-info/METADATA")
    lines = [line for line in metadata.read_text().splitlines() if line.startswith("Requires-Dist:")]
    found = []
    for line in lines:
        extra = re.search(r"extra == [\"'](.*?)[\"']", line)
        if extra is None or extra[1] in extras:
            found.append(re.split(r"[ <>=!~;\[]", line.split(": ")[1])[0])
    return found


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of an environment into which only the wheel was installed."""
    folder = tmp_path_factory.mktemp("installed")
    copy_sources(folder / "sources")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    wheels, environment = folder / "wheels", folder / "environment"
    offline = ("--no-deps", "--no-build-isolation", "--wheel-dir", wheels)
    run(*pip, "wheel", ".", *offline, cwd=folder / "sources")
    (wheel,) = wheels.iterdir()
    venv.create(environment, symlinks=True)
    python = environment / "bin" / "python3"
    run(*pip, "--python", python, "install", "--no-deps", "--no-index", "--no-compile", wheel, cwd=folder)
    link_what_the_wheel_needs(site_of(environment))
    return python.parent


def site_of(environment: Path) -> Path:
    return Path(sysconfig.get_path("purelib", "venv", {"base": str(environment)}))


@pytest.fixture
def program(installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same folder; commands find its programs first, and nothing of this checkout."""
    runtime = tmp_path / "runtime"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.setenv("PATH", f"{installed}:{os.environ['PATH']}")
    return installed


def own_run() -> str:
    """Id of the run whose memory is made, '' if there is none yet; others may run on this machine."""
    mine = [run for run in live_runs() if run.folder.is_relative_to(os.environ["XDG_RUNTIME_DIR"])]
    return mine[0].run_id if mine and (mine[0].folder / SOCKET_NAME).exists() else ""


@pytest.mark.every_turn
def test_new_robot_runs_with_only_the_wheel_installed(program: Path, tmp_path: Path) -> None:
    run("robbie", "new", "my-robot", cwd=tmp_path)
    robot = tmp_path / "my-robot"
    where = run("python3", "-c", "import robbie_mp; print(robbie_mp.__file__)", cwd=robot)
    assert Path(where.strip()).is_relative_to(program.parent)
    assert "OK" in run("python3", "-m", "unittest", cwd=robot)
    process = subprocess.Popen(
        ["robbie", "run", "robot", "--quiet"], cwd=robot, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    try:
        wait_until(lambda: own_run() != "", LIMIT_S)
        wait_until(
            lambda: "sensor" in run("robbie", "list", "topics", "--run", own_run(), cwd=tmp_path), LIMIT_S
        )
        message = run("robbie", "echo", "ProcessorLoad", "--once", "--json", "--run", own_run(), cwd=robot)
        assert json.loads(message)["sender"] == "sensor"
    finally:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, output


def states_of(run_id: str, folder: Path) -> set[str]:
    """The states of the modules of a run; none before there is one."""
    if not run_id:
        return set()
    rows = json.loads(run("robbie", "list", "modules", "--json", "--run", run_id, cwd=folder))
    return {row["state"] for row in rows}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", EXTRAS)
def test_stock_robot_runs_in_an_empty_folder_with_only_the_wheel_installed(
    name: str, program: Path, tmp_path: Path
) -> None:
    link_what_the_wheel_needs(site_of(program.parent), EXTRAS[name].split(","))
    (folder := tmp_path / "empty").mkdir()
    command = ["robbie", "run", f"robbie:{name}", "--quiet"]
    if name == "spoken":  # without a sound card
        with wave.open(str(tmp_path / "silence.wav"), "wb") as silence:
            silence.setparams((1, 2, 16000, 0, "NONE", ""))
            silence.writeframes(bytes(64000))
        command += ["--var", "has_sound_card=false", "--var", f"recording={tmp_path / 'silence.wav'}"]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    try:
        wait_until(lambda: process.poll() is not None or states_of(own_run(), folder) == {"RUNNING"}, LIMIT_S)
    finally:
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, output


def test_results_of_a_stock_robot_are_where_it_was_started(program: Path, tmp_path: Path) -> None:
    link_what_the_wheel_needs(site_of(program.parent), ["robot"])
    limit = ("--set", "exploration.time_limit_s=3")
    said = run("robbie", "run", "robbie:demo-recorded", "--output", "results", *limit, cwd=tmp_path)
    assert (tmp_path / "results" / "map.png").is_file(), said
    (log,) = (tmp_path / "logs").iterdir()
    assert "LaserScan" in run("robbie", "info", log, cwd=tmp_path)


def test_users_profile_and_code_use_the_stock_robots(program: Path, tmp_path: Path) -> None:
    link_what_the_wheel_needs(site_of(program.parent), ["robot"])
    for folder in ("modules", "profiles"):
        (tmp_path / "robot" / folder).mkdir(parents=True)
    robot = tmp_path / "robot"
    (robot / "modules" / "__init__.py").touch()
    (robot / "modules" / "mine.py").write_text(USER_CODE)
    (robot / "profiles" / "mine.yaml").write_text(USER_PROFILE)
    shown = run("robbie", "profile", "show", "mine", "--without", "victims", cwd=robot)
    assert "port: /dev/ttyUSB0" in shown and "cannot be imported" not in shown
    # Other type checkers refuse a narrower attribute than the base class's.
    strict = ["--strict", "--enable-error-code", "mutable-override"]
    mypy = [sys.executable, "-m", "mypy", *strict, "--python-executable", str(program / "python3")]
    done = subprocess.run(
        [*mypy, "-p", "modules"], cwd=robot, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    expected = 'Incompatible return value type (got "float", expected "str")  [return-value]'
    assert re.findall(r"error: (.*)", done.stdout) == [expected], done.stdout
