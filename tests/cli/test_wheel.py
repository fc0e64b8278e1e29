"""The wheel is complete: installed alone into an empty environment, outside any checkout."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Iterator
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest

from robbie_mp.cli.runs import live_runs
from robbie_mp.run.control import SOCKET_NAME
from tests._support.robot import wait_until
from tests.docs._support.pages import ROOT

pytestmark = pytest.mark.slow

LIMIT_S = 60.0


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
        if name and name[0] not in found and not condition:
            found[name[0]] = distribution(name[0])
            required(name[0], found)
    return found


def link_what_the_wheel_needs(site: Path) -> None:
    """Make what the wheel says it needs, and nothing else, importable: no network is asked for it."""
    for name in required_by_wheel(site):
        for needed in {name: distribution(name), **required(name)}.values():
            for file in needed.files or []:
                top = file.parts[0]
                if top not in ("..", "__pycache__") and not (site / top).exists():
                    (site / top).symlink_to(str(needed.locate_file(top)))


def required_by_wheel(site: Path) -> list[str]:
    (metadata,) = site.glob("robbie_mp-*.dist-info/METADATA")
    lines = [line for line in metadata.read_text().splitlines() if line.startswith("Requires-Dist:")]
    return [re.split(r"[ <>=!~;\[]", line.split(": ")[1])[0] for line in lines if "extra ==" not in line]


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of programs of an environment into which only the wheel was installed."""
    sources = tmp_path / "sources"
    sources.mkdir()
    shutil.copytree(ROOT / "robbie_mp", sources / "robbie_mp", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, sources)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    wheels = tmp_path / "wheels"
    run(*pip, "wheel", ".", "--no-deps", "--no-build-isolation", "--wheel-dir", wheels, cwd=sources)
    (wheel,) = wheels.iterdir()
    environment = tmp_path / "environment"
    venv.create(environment, symlinks=True)
    python = environment / "bin" / "python3"
    run(*pip, "--python", python, "install", "--no-deps", "--no-index", "--no-compile", wheel, cwd=tmp_path)
    site = Path(sysconfig.get_path("purelib", "venv", {"base": str(environment)}))
    link_what_the_wheel_needs(site)
    runtime = tmp_path / "runtime"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.setenv("PATH", f"{python.parent}:{os.environ['PATH']}")
    yield python.parent


def own_run() -> str:
    """Id of the run whose memory is made, '' if there is none yet; others may run on this machine."""
    mine = [run for run in live_runs() if run.folder.is_relative_to(os.environ["XDG_RUNTIME_DIR"])]
    return mine[0].run_id if mine and (mine[0].folder / SOCKET_NAME).exists() else ""


def test_new_robot_runs_with_only_the_wheel_installed(program: Path, tmp_path: Path) -> None:
    run("robbie", "new", "my-robot", cwd=tmp_path)
    robot = tmp_path / "my-robot"
    where = run("python3", "-c", "import robbie_mp; print(robbie_mp.__file__)", cwd=robot)
    assert Path(where.strip()).is_relative_to(tmp_path)
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
