"""The rescue robot goes on after each of its cables was pulled and plugged in again."""

import random
from contextlib import closing
from pathlib import Path

import pytest

from robbie_mp.attached.tool.tool import Tool
from robbie_mp.run.run_directory import list_runs
from tests.robot._support.replug import MEASUREMENT, Replugs, Witness, replug
from tools.robot import REPOSITORY, Robot

SETTINGS = ("--set", "mission.time_limit_s=3000.0", "--set", "navigation.max_recoveries=100")


@pytest.mark.slow
@pytest.mark.timeout(420)
def test_robot_goes_on_after_each_of_its_cables_was_pulled(tmp_path: Path) -> None:
    results = {name: Replugs() for name in MEASUREMENT}
    with closing(Robot(tmp_path, REPOSITORY, "rescue-emulated", *SETTINGS)) as robot:
        robot.wait_until_running()
        (run,) = list_runs(robot.bases)
        with closing(Tool(run, "pulls plugs")) as tool:
            witness = Witness(tool)
            witness.wait_for(lambda: witness.moves, "the robot moves", 120.0)
            for name, result in results.items():
                replug(witness, name, random.Random(1), result)
        summary = robot.stop()
    assert summary["exit_code"] == 0
    assert all(module["restarts"] == 0 for module in summary["modules"])
    assert all(len(each.back_s) == 1 and each.stale == 0 for each in results.values())
    assert len(results["base"].drives_s) == len(results["base"].stands_s) == 1
