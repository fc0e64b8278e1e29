"""The stock robots are a library: profiles, files and code with one name each, in every folder."""

import re
from pathlib import Path

import pytest

from robbie_mp.base.problem import ProfileError
from robbie_mp.base.stock_robots import ROBOTS
from robbie_mp.cli.new import EXTRAS
from robbie_mp.module.settings import REQUIRED, check_settings, setting
from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.workspace import STOCK_FOLDERS
from tests.run.profile.conftest import Robot

PROFILES = sorted((ROBOTS / "profiles").rglob("*.yaml"))
BARE = re.compile(r"""(?<![\w./-])(?:modules|workers|hw)(?:\.\w+)+:[A-Z]|[ {]\w+: ["']?hw/""")
"""A class or a file of a stock robot by a name that would be looked up in the user's workspace."""

DRIVERS = {
    name
    for path in (ROBOTS / "modules").rglob("*.py")
    if "DriveCommand(\n" in (text := path.read_text()) and 'topic="manual"' not in text
    for name in re.findall(r"^class (\w+)\(Module\)", text, re.MULTILINE)
}
"""The modules that publish `DriveCommand` by themselves."""


class Reader:
    file: Path = setting(REQUIRED, "a file", must_exist=True)


@pytest.mark.parametrize("name", EXTRAS)
def test_stock_robot_needs_no_workspace(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    profile = load_profile(f"robbie:{name}")
    assert profile.workspace == tmp_path
    assert {module.class_path.partition(".")[0] for module in profile.modules} <= {
        "robbie_robots",
        "robbie_mp",
    }


def test_users_profile_takes_parts_and_files_of_the_stock_robots(robot: Robot) -> None:
    robot.write("demo", "parents: [robbie:parts/rescue-robot]")
    assert "mission" in {module.name for module in robot.load().modules}
    settings = check_settings(Reader, {"file": "robbie:hw/robots/rescue.yaml"}, folder=robot.root)
    assert settings["file"] == ROBOTS / "hw" / "robots" / "rescue.yaml"


def test_users_own_names_never_stand_for_stock_ones(robot: Robot) -> None:
    robot.write("parts/rescue-robot", "description: mine")
    robot.write("demo", "parents: [parts/rescue-robot, robbie:parts/rescue-robot]")
    assert {module.name for module in robot.load().modules} >= {"mission", "mapping"}


def test_stock_robot_without_its_prefix_is_suggested(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="did you mean 'robbie:home'"):
        load_profile("home", tmp_path)


@pytest.mark.parametrize(
    "file", [one for one in PROFILES if one.parent.name == "profiles"], ids=lambda file: file.stem
)
def test_no_stock_robot_has_two_modules_that_drive(file: Path, tmp_path: Path) -> None:
    """The base follows one of them."""
    modules = load_profile(f"robbie:{file.stem}", tmp_path).modules
    drivers = [one.name for one in modules if one.class_path.partition(":")[2] in DRIVERS]
    assert len(drivers) <= 1


@pytest.mark.parametrize("file", PROFILES, ids=lambda file: file.stem)
def test_stock_profile_names_nothing_of_a_workspace(file: Path) -> None:
    assert not BARE.findall(file.read_text())
    for parents in re.findall(r"^parents: \[(.*)\]", file.read_text(), re.MULTILINE):
        assert all(name.strip().startswith("robbie:") for name in parents.split(","))


def test_names_of_stock_profiles_are_unique() -> None:
    parents, robots = ({file.stem for file in folder.glob("*.yaml")} for folder in STOCK_FOLDERS)
    assert parents and robots and not parents & robots
