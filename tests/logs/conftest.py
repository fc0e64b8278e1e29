from pathlib import Path

import pytest

from tests._support.robot import Robot

PROFILE = """
modules:
  witness: {class: "crew.modules:Witness"}
  playback: {class: "robbie_mp.logs.playback.module:Playback", essential: true, ends_run: true}
clock: {source: playback}
"""


@pytest.fixture
def player_robot(robot: Robot) -> Robot:
    """A robot with a witness and a playback."""
    (robot.folder / "crew").mkdir()
    (robot.folder / "crew" / "__init__.py").write_text("")
    modules = (Path(__file__).parent / "_support" / "robot_modules.py").read_text()
    (robot.folder / "crew" / "modules.py").write_text(modules)
    robot.write_profile(PROFILE)
    return robot
