"""The installation builds the C with a compiler, and says plainly that it did not without one."""

import os
import platform
import subprocess
import sys
import tarfile
import venv
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

from robbie_mp.bus._hot.sources import KINDS, sources_in
from tests._support.sources import copy_sources
from tests.bus.hot._support.build import HOT
from tests.docs._support.pages import ROOT
from tools.wheels import PROCESSORS

pytestmark = [pytest.mark.slow, pytest.mark.timeout(700)]

LIMIT_S = 600.0
"""It compiles the hot path, which on a busy machine takes ten times as long as on an idle one."""
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
    here = {path.name for path in sources_in(HOT)}
    with tarfile.open(archive) as found:
        names = found.getnames()
    assert {Path(name).name for name in names if name.endswith(KINDS)} == here
    assert not [name for name in names if name.endswith(".so")]


def test_wheel_has_what_was_built_and_no_sources(archive: Path, tmp_path: Path) -> None:
    wheel, _ = build(archive, tmp_path, ROBBIE_STRICT_BUILD="1")
    with zipfile.ZipFile(wheel) as found:
        names = [name for name in found.namelist() if name.startswith("robbie_mp/bus/_hot/")]
    assert [name for name in names if name.endswith(KINDS)] == []
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
    assert answer.startswith("False it was not built: there was no working C compiler")


def test_build_without_cython_says_so_in_one_line(tmp_path: Path) -> None:
    sources, packages = tmp_path / "sources", tmp_path / "packages"
    copy_sources(sources)
    packages.mkdir()
    for name in ("setuptools", "_distutils_hack"):
        found = find_spec(name)
        assert found is not None and found.origin is not None
        (packages / name).symlink_to(Path(found.origin).parent)
    build_it = (sys.executable, "-S", "setup.py", "-q", "build_ext")
    printed = run(*build_it, cwd=sources, PYTHONPATH=str(packages), ROBBIE_STRICT_BUILD="")
    assert printed.splitlines() == [
        "Robbie-MP uses Python for its hot path, which is slower: "
        "Cython is not installed; install it with pip (pip install cython)"
    ]


def test_strict_installation_without_a_compiler_fails(archive: Path, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="there is no C compiler"):
        build(archive, tmp_path, CC="no-such-compiler", ROBBIE_STRICT_BUILD="1")


@pytest.fixture(scope="module")
def released(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """For each processor the wheel of this Python, as a release has it."""
    for needed in ("auditwheel", "ziglang"):
        pytest.importorskip(needed, reason=f"{needed} is not installed (pip install -e '.[wheels]')")
    folder = tmp_path_factory.mktemp("released")
    # pip understands this so that the build uses what is installed here: no network is asked.
    offline = {"PIP_NO_BUILD_ISOLATION": "0"}
    command = (sys.executable, "-m", "tools.wheels", archive, sys.executable, "--out", folder)
    printed = run(*command, cwd=ROOT, **offline)
    wheels = {processor: next(folder.glob(f"*_{processor}.whl")) for processor in PROCESSORS}
    assert printed.splitlines() == [f"{wheel.name}: needs glibc 2.17" for wheel in wheels.values()]
    return wheels


@pytest.mark.parametrize(("processor", "elf_machine"), [("x86_64", 62), ("aarch64", 183)])
def test_released_wheel_says_for_which_python_and_machine_it_is(
    processor: str, elf_machine: int, released: dict[str, Path]
) -> None:
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert released[processor].stem.split("-")[2:] == [python, python, f"manylinux_2_31_{processor}"]
    with zipfile.ZipFile(released[processor]) as found:
        (native,) = [name for name in found.namelist() if name.endswith(".so")]
        header = found.read(native)[:20]
    assert native.endswith(f".{sys.implementation.cache_tag}-{processor}-linux-gnu.so")
    assert int.from_bytes(header[18:20], "little") == elf_machine


def test_released_wheel_uses_c(released: dict[str, Path], tmp_path: Path) -> None:
    assert answer_of(released[platform.machine()], tmp_path) == "True"
