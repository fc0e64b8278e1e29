"""A workspace as `robbie new` makes it."""

import subprocess
import sys
from pathlib import Path

import pytest

from robbie_mp.cli import main
from robbie_mp.cli.new import make_workspace
from tests.docs._support.pages import ROOT


def test_no_placeholder_remains(tmp_path: Path) -> None:
    made = make_workspace(tmp_path / "My 2nd-Robot")
    assert all("{{" not in file.read_text() for file in made)
    assert (
        'name="my_2nd_robot/msg/ProcessorLoad"' in (tmp_path / "My 2nd-Robot/modules/messages.py").read_text()
    )


def test_generated_code_passes_our_checks(tmp_path: Path) -> None:
    make_workspace(tmp_path / "robot")
    config = ["--no-cache", "--config", str(ROOT / "pyproject.toml")]
    check = subprocess.run(
        [sys.executable, "-m", "ruff", "check", *config, "."],
        cwd=tmp_path / "robot", capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert check.returncode == 0, check.stdout
    form = subprocess.run(
        [sys.executable, "-m", "ruff", "format", "--check", *config, "."],
        cwd=tmp_path / "robot", capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert form.returncode == 0, form.stdout


def test_folder_in_use_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "diary.txt").write_text("mine")
    assert main(["new", str(tmp_path)]) == 1
    assert "is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["diary.txt"]


def test_name_without_a_letter_is_refused(tmp_path: Path) -> None:
    assert main(["new", str(tmp_path / "42")]) == 1
    assert not (tmp_path / "42").exists()
