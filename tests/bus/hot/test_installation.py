"""The installation builds the C with a compiler, and says plainly that it did not without one."""

import os
import shlex
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from robbie_mp.bus._hot.choice import PURE_PYTHON, why_not
from tests._support.implementations import NATIVE
from tests._support.sources import copy_sources
from tests.docs._support.pages import ROOT

pytestmark = pytest.mark.slow

LIMIT_S = 100.0
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")
ASK = "from robbie_mp.bus._hot.choice import native, why_not; print(native() is not None, why_not())"


def run(*command: str | Path, cwd: Path, **environment: str) -> str:
    """Run a command, and return all that it prints."""
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        timeout=LIMIT_S, check=False, env={**os.environ, **environment},
    )  # fmt: skip
    assert done.returncode == 0, f"{command}\n{done.stdout}"
    return done.stdout


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution."""
    folder = tmp_path_factory.mktemp("sdist")
    sources = folder / "sources"
    copy_sources(sources)
    run(sys.executable, "setup.py", "-q", "sdist", "--dist-dir", folder / "made", cwd=sources)
    (made,) = (folder / "made").iterdir()
    return made


def build(archive: Path, folder: Path, *options: str, **environment: str) -> tuple[Path, str]:
    """Build a wheel from the source distribution; return it and what pip printed."""
    wheels = folder / "wheels"
    offline = ("--no-deps", "--no-build-isolation", "--no-cache-dir", "--wheel-dir", wheels)
    printed = run(*PIP, "wheel", *options, *offline, archive, cwd=folder, **environment)
    (wheel,) = wheels.iterdir()
    return wheel, printed


def answer_of(wheel: Path, folder: Path) -> str:
    """Install a wheel into an empty environment, and let it say which form of the hot path it uses."""
    venv.create(folder / "environment", symlinks=True)
    python = folder / "environment" / "bin" / "python3"
    run(*PIP, "--python", python, "install", "--no-deps", "--no-index", "--no-compile", wheel, cwd=folder)
    return run(python, "-c", ASK, cwd=folder, ROBBIE_PURE_PYTHON="").strip()


def test_source_distribution_has_all_sources(archive: Path) -> None:
    here = {
        path.name for path in (ROOT / "robbie_mp" / "bus" / "_hot").iterdir() if path.suffix in (".c", ".h")
    }
    with tarfile.open(archive) as found:
        names = found.getnames()
    assert {Path(name).name for name in names if name.endswith((".c", ".h"))} == here
    assert not [name for name in names if name.endswith(".so")]


def test_wheel_has_what_was_built_and_no_sources(archive: Path, tmp_path: Path) -> None:
    wheel, _ = build(archive, tmp_path, ROBBIE_STRICT_BUILD="1")
    with zipfile.ZipFile(wheel) as found:
        names = [name for name in found.namelist() if name.startswith("robbie_mp/bus/_hot/")]
    assert [name for name in names if name.endswith((".c", ".h"))] == []
    assert len([name for name in names if name.endswith(".so")]) == 1
    assert "robbie_mp/bus/_hot/native.pyi" in names
    assert answer_of(wheel, tmp_path) == "True"


def test_installation_without_a_compiler_says_so_in_one_line_and_uses_python(
    archive: Path, tmp_path: Path
) -> None:
    wheel, printed = build(archive, tmp_path, "-v", CC="no-such-compiler", ROBBIE_STRICT_BUILD="")
    said = [line.strip() for line in printed.splitlines() if "no-such-compiler" in line]
    assert said == [
        "Robbie-MP uses Python for its hot path, which is slower: "
        "there is no C compiler (no-such-compiler); install gcc"
    ]
    assert "Traceback" not in printed
    answer = answer_of(wheel, tmp_path)
    assert answer.startswith("False it was not built, because there was no working C compiler")


def test_strict_installation_without_a_compiler_fails(archive: Path, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="there is no C compiler"):
        build(archive, tmp_path, CC="no-such-compiler", ROBBIE_STRICT_BUILD="1")


@pytest.mark.skipif(NATIVE is None, reason=why_not() or "C")
def test_wheel_passes_its_check_only_if_it_has_the_hot_path_in_c() -> None:
    """The command with which cibuildwheel checks each wheel that it has built."""
    tomllib = pytest.importorskip("tomllib")  # since Python 3.11
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["cibuildwheel"]
    python, *arguments = shlex.split(settings["test-command"])
    assert python == "python"
    for pure, code in (("", 0), ("1", 1)):
        done = subprocess.run(
            [sys.executable, *arguments], env={**os.environ, PURE_PYTHON: pure}, cwd=ROOT,
            capture_output=True, text=True, check=False, timeout=LIMIT_S,
        )  # fmt: skip
        assert done.returncode == code, done.stderr
    assert f"{PURE_PYTHON}=1 is set" in done.stderr
