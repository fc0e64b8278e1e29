"""A workspace as `robbie new` makes it."""

import subprocess
import sys
from pathlib import Path

import pytest

from robbie_mp.cli import main
from robbie_mp.cli.new import copy_example, make_workspace
from robbie_mp.cli.stock_robots import STOCK_ROBOTS, needed_files
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


@pytest.mark.slow
def test_copied_stock_robot_is_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = copy_example("rescue", tmp_path)  # tests of the wheel run the other one
    assert "{{" not in (tmp_path / "README.md").read_text()
    monkeypatch.chdir(tmp_path)
    code = [file.relative_to(tmp_path) for file in made if file.suffix == ".py"]
    names = [".".join(file.with_suffix("").parts) for file in code]
    program = f"from importlib import import_module\nfor name in {names!r}: import_module(name)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("example", STOCK_ROBOTS)
def test_profiles_of_a_copied_stock_robot_have_all_parents(
    example: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy_example(example, tmp_path)
    monkeypatch.chdir(tmp_path)
    for profile in STOCK_ROBOTS[example].profiles:
        assert load_profile(profile).workspace == tmp_path


def test_copied_stock_robot_has_what_its_code_and_profiles_name(tmp_path: Path) -> None:
    made = {file.relative_to(tmp_path).as_posix() for file in copy_example("rescue", tmp_path)}
    assert {
        "hw/robots/rescue.yaml", "hw/simulation/arenas/rescue_maze.yaml",
        "profiles/parts/rescue-operator.yaml",
        "modules/rescue/station/victim_question.js", "modules/rescue/station/victim_question.css",
        "LICENSE", "README.md", ".gitignore",
    } <= made  # fmt: skip
    assert not [file for file in made if file.startswith(("robbie_mp", "tests", "modules/exploration"))]


def test_needed_files_are_found_by_imports_and_names(tmp_path: Path) -> None:
    texts = {
        "profiles/robot.yaml": "parents: [parts/a, robbie:recorded]\nmodules: {m: {class: 'modules.m:M'}}",
        "profiles/parts/a.yaml": "modules: {m: {settings: {map: hw/maps/hall.yaml}}}",
        "profiles/other.yaml": "modules: {n: {class: 'modules.n:N'}}",
        "modules/__init__.py": "",
        "modules/m.py": "def late():\n    from workers import w\n    return open('page.js')",
        "modules/n.py": "",
        "modules/page.js": "",
        "workers/__init__.py": "",
        "workers/w/__init__.py": "from workers.w.inner import x",
        "workers/w/inner.py": "import numpy, os.path, robbie_mp.base.errors",
        "hw/maps/hall.yaml": "picture: hall.png",
        "hw/maps/hall.png": "",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    found = {file.as_posix() for file in needed_files(tmp_path, ["robot"])}
    assert set(texts) - found == {"profiles/other.yaml", "modules/n.py"}


def test_example_needs_no_folder_and_a_new_robot_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "--example", "demo"]) == 0
    assert "pip install 'robbie-mp[robot]'\n    cd demo\n    robbie run demo\n" in capsys.readouterr().out
    assert main(["new", "--example", "demo"]) == 1
    with pytest.raises(SystemExit) as caught:
        main(["new"])
    assert caught.value.code == 2
    assert "name a folder for the new robot, or an --example" in capsys.readouterr().err


def test_folder_in_use_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "diary.txt").write_text("mine")
    assert main(["new", str(tmp_path)]) == 1
    assert "is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["diary.txt"]


def test_name_without_a_letter_is_refused(tmp_path: Path) -> None:
    assert main(["new", str(tmp_path / "42")]) == 1
    assert not (tmp_path / "42").exists()
