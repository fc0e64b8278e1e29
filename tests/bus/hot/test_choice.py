"""The hot path runs in C or in Python, and Robbie says why if it is not C."""

import importlib
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import SimpleNamespace

import pytest

from robbie_mp.bus import _hot
from robbie_mp.bus._hot import choice
from robbie_mp.bus._hot.sources import digest
from robbie_mp.bus.transport.layout import LAYOUT_VERSION
from tools import layout_header

HOT = Path(choice.__file__).parent
MODULE = "robbie_mp.bus._hot.native"


@pytest.fixture(autouse=True)
def choice_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the tests decide what the environment says."""
    monkeypatch.delenv(choice.PURE_PYTHON, raising=False)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that the choice takes for its own, with C sources in it."""
    (tmp_path / "native.c").write_text("int x;")
    monkeypatch.setattr(choice, "_HERE", tmp_path)
    return tmp_path


def pretend(monkeypatch: pytest.MonkeyPatch, **constants: object) -> object:
    """Put a module with these constants in the place of the one written in C."""
    module = SimpleNamespace(**constants)
    monkeypatch.setattr(_hot, "native", module, raising=False)
    return module


def pretend_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(_hot, "native", raising=False)
    monkeypatch.setitem(sys.modules, MODULE, None)


def test_c_is_used_wherever_it_can_be_built() -> None:
    if shutil.which("gcc") is None or not Path(sysconfig.get_path("include"), "Python.h").is_file():
        pytest.skip("NOT TESTED: there is no gcc here, or the headers of Python are missing")
    assert choice.why_not() == ""
    assert choice.native() is importlib.import_module(MODULE)


def test_module_of_the_same_layout_and_sources_is_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = pretend(monkeypatch, LAYOUT_VERSION=LAYOUT_VERSION, SOURCES=digest(folder))
    assert (choice.native(), choice.why_not()) == (module, "")


def test_installed_module_without_sources_beside_it_is_used(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "native.c").unlink()
    module = pretend(monkeypatch, LAYOUT_VERSION=LAYOUT_VERSION, SOURCES="of the wheel")
    assert (choice.native(), choice.why_not()) == (module, "")


def test_variable_chooses_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(choice.PURE_PYTHON, "1")
    assert choice.native() is None
    assert choice.why_not() == "ROBBIE_PURE_PYTHON=1 is set; unset it to use C"


@pytest.mark.parametrize("value", ["", "0"])
def test_variable_that_says_no_changes_nothing(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = choice.why_not()
    monkeypatch.setenv(choice.PURE_PYTHON, value)
    assert choice.why_not() == before


def test_python_without_the_lock_is_refused_before_the_import(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "abiflags", "t")
    monkeypatch.delitem(sys.modules, MODULE, raising=False)
    monkeypatch.delattr(_hot, "native", raising=False)
    assert "no global interpreter lock" in choice.why_not()
    assert MODULE not in sys.modules


def test_module_that_was_never_built(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pretend_missing(monkeypatch)
    assert choice.native() is None
    assert "no working C compiler" in choice.why_not()
    assert "apt-get install gcc python3-dev" in choice.why_not()


def test_module_of_another_python(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pretend_missing(monkeypatch)
    (folder / "native.cpython-37m-x86_64-linux-gnu.so").touch()
    assert "built for another Python (native.cpython-37m-x86_64-linux-gnu.so)" in choice.why_not()


def test_module_that_cannot_be_loaded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pretend_missing(monkeypatch)
    (folder / f"native{sysconfig.get_config_var('EXT_SUFFIX')}").touch()
    assert "cannot be loaded (" in choice.why_not()


@pytest.mark.parametrize("constants", [{}, {"LAYOUT_VERSION": LAYOUT_VERSION - 1}])
def test_module_of_another_layout(
    constants: dict[str, int], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend(monkeypatch, SOURCES=digest(folder), **constants)
    assert choice.native() is None
    assert f"not {LAYOUT_VERSION}" in choice.why_not()


def test_module_built_before_a_source_was_changed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = pretend(monkeypatch, LAYOUT_VERSION=LAYOUT_VERSION, SOURCES=digest(folder))
    assert choice.native() is module
    (folder / "native.c").write_text("int y;")
    assert "built from other sources" in choice.why_not()


def test_digest_tells_contents_and_names_apart(tmp_path: Path) -> None:
    assert digest(tmp_path) == ""
    (tmp_path / "one.c").write_text("text")
    first = digest(tmp_path)
    (tmp_path / "one.c").rename(tmp_path / "two.c")
    second = digest(tmp_path)
    (tmp_path / "two.c").write_text("other")
    assert len({first, second, digest(tmp_path)}) == 3


def test_header_has_the_constants_of_python() -> None:
    assert layout_header.HEADER.read_text() == layout_header.header(), (
        "write it again with `python -m tools.layout_header`"
    )


def test_import_of_the_choice_does_not_load_the_module() -> None:
    code = f"import sys; import robbie_mp.bus._hot.choice; sys.exit({MODULE!r} in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], env=dict(os.environ), cwd=HOT.parents[1], check=False)
    assert done.returncode == 0
