"""A workspace as `robbie new` makes it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from robbie_mp.base import extras
from robbie_mp.cli import main
from robbie_mp.cli.new import EXTRAS, copy_example, make_workspace
from robbie_mp.run.profile.load import load_profile
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


@pytest.mark.parametrize("example", EXTRAS)
def test_copied_profile_is_the_stock_robot_and_may_be_changed(
    example: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = {file.relative_to(tmp_path).as_posix() for file in copy_example(example, tmp_path)}
    assert made == {"README.md", ".gitignore", f"profiles/{example}.yaml"}
    assert "{{" not in (tmp_path / "README.md").read_text()
    monkeypatch.chdir(tmp_path)
    copied, stock = load_profile(example), load_profile(f"robbie:{example}")
    assert copied.workspace == stock.workspace == tmp_path
    assert copied.modules == stock.modules
    file = tmp_path / "profiles" / f"{example}.yaml"
    file.write_text(
        file.read_text().replace("modules:\n", "modules:\n  own: {class: 'modules.own:Own'}\n", 1)
    )
    assert {module.name for module in load_profile(example).modules} - {
        one.name for one in stock.modules
    } == {"own"}


def test_example_needs_no_folder_and_a_new_robot_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(extras, "installed", lambda package: None if package == "scipy" else "9")
    assert main(["new", "--example", "demo"]) == 0
    assert "pip install 'scipy>=1.11'\n    cd demo\n    robbie run demo\n" in capsys.readouterr().out
    assert main(["new", "--example", "demo"]) == 1
    with pytest.raises(SystemExit) as caught:
        main(["new"])
    assert caught.value.code == 2
    assert "name a folder for the new robot, or an --example" in capsys.readouterr().err


def test_new_robot_has_files_for_ci_commits_and_an_editor(tmp_path: Path) -> None:
    made = {file.relative_to(tmp_path / "robot").as_posix() for file in make_workspace(tmp_path / "robot")}
    assert made >= {
        ".gitignore", ".github/workflows/test.yml", ".pre-commit-config.yaml", ".vscode/settings.json",
        ".vscode/launch.json",
    }  # fmt: skip
    for name in ("settings", "launch"):
        json.loads((tmp_path / "robot/.vscode" / f"{name}.json").read_text())
    workflow = yaml.safe_load((tmp_path / "robot/.github/workflows/test.yml").read_text())
    hooks = yaml.safe_load((tmp_path / "robot/.pre-commit-config.yaml").read_text())
    assert len(hooks["repos"]) == 2
    commands = [step["run"] for step in workflow["jobs"]["test"]["steps"] if "run" in step]
    assert "python -m unittest" in commands


@pytest.mark.slow
def test_commands_of_the_workflow_pass_in_a_new_workspace(tmp_path: Path) -> None:
    make_workspace(tmp_path / "robot")
    workflow = yaml.safe_load((tmp_path / "robot/.github/workflows/test.yml").read_text())
    commands = [step["run"] for step in workflow["jobs"]["test"]["steps"] if "run" in step]
    programs = Path(sys.executable).parent
    for command in commands[1:]:  # without pip
        done = subprocess.run(
            ["sh", "-c", command], cwd=tmp_path / "robot", capture_output=True, text=True, timeout=100,
            env=os.environ | {"PATH": f"{programs}:{os.environ['PATH']}", "MYPYPATH": str(ROOT)}, check=False,
        )  # fmt: skip
        assert done.returncode == 0, command + done.stdout + done.stderr


def test_folder_in_use_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "diary.txt").write_text("mine")
    assert main(["new", str(tmp_path)]) == 1
    assert "is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["diary.txt"]


def test_name_without_a_letter_is_refused(tmp_path: Path) -> None:
    assert main(["new", str(tmp_path / "42")]) == 1
    assert not (tmp_path / "42").exists()
