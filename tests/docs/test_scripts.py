"""The scripts in docs/scripts.md work as described, one after the other, on a simulated robot."""

import re
from typing import Any

import pytest

from tests._support.robot import Robot, wait_until
from tests.docs._support.pages import ROOT, block

PAGE = "docs/scripts.md"
ARENA = ROOT / "hw" / "simulation" / "arenas" / "demo.yaml"
PROFILE = f"""
modules:
  base: {{class: "robbie_robots.modules.devices.base:SimulatedBase", settings: {{arena: "{ARENA}"}}}}
  laser:
    class: robbie_robots.modules.devices.laser:SimulatedLaserRangeFinder
    settings: {{arena: "{ARENA}"}}
"""


@pytest.mark.slow
def test_scripts_on_the_page_work(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(lambda modules: modules["laser"]["published"] > 0)
    names: dict[str, Any] = {}

    def printed(mark: str) -> str:
        exec(block(PAGE, mark), names)
        return capsys.readouterr().out

    assert re.fullmatch(r"nearest obstacle: \d+\.\d\d m\n", printed("listen"))
    assert re.fullmatch(r"(message \d+ of laser; missed 0\n)+", printed("count"))
    printed("collect")
    rows, columns = names["track_m"].shape
    assert (rows > 5, columns) == (True, 2)
    assert printed("change") == "{'base': 'RUNNING', 'laser': 'RUNNING'}\n"
    assert names["before"] == names["run"].parameters["laser.virtual_failure"]
    wait_until(lambda: not [name for name in robot.top() if name.startswith("~")])
