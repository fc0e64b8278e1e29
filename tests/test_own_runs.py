"""Tests see the runs of their own session alone, so that their outcome does not rest on what else runs."""

from pathlib import Path

from robbie_mp.run.live_runs import live_runs
from robbie_mp.run.run_directory import RunDirectory
from tests._support.own_runs import EVERY_BASE_FOLDER
from tests._support.robot import Robot


def test_running_robot_of_the_user_is_not_seen(robot: Robot, tmp_path: Path) -> None:
    run = RunDirectory.create("a robot of the user", tmp_path, EVERY_BASE_FOLDER()[-1])
    try:
        assert not run.folder.is_relative_to(tmp_path)
        assert live_runs() == []
        assert run.run_id not in robot.command("list").stdout
    finally:
        run.remove()
