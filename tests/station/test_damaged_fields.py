"""The running operator station and its panels survive messages with damaged fields; its page stays up."""

import json
import re
from collections.abc import Iterable
from pathlib import Path

import pytest

from robbie_mp.station.panel_classes import FRAMEWORK_PANELS
from tests._support import damage
from tests._support.robot import Robot
from tests.security.station._support.attacker import Attacker
from tests.station.test_page import address_of

TOKEN = "opens-everything"
MODULES = """
import json
from robbie_mp import Module
from robbie_mp.messages import stock_registry
from zoo.damage import damaged, plausible


class Damager(Module):
    # publishes on each channel of a list one damaged message after another
    period_s = 0.05
    waiting = None

    def tick(self):
        file = self.output_directory / "channels.json"
        if self.waiting is None and file.exists():
            types = {one.type_name: one for one in stock_registry()}
            channels = [(types[name], topic) for name, topic in json.loads(file.read_text()) if name in types]
            self.waiting = [(topic, damaged(plausible(one))) for one, topic in channels]
            self.types, self.fields = len({one for one, _ in channels}), 0
        for topic, messages in list(self.waiting or []):
            found = next(messages, None)
            if found is None:
                self.waiting = [one for one in self.waiting if one[1] is not messages]
                continue
            self.fields += 1
            _, message = found
            self.publish_encoded(message.type_name, message.version, message.encode(), topic=topic)
        if self.waiting == []:
            self.status = f"done: {self.types} types, {self.fields} damaged fields"


class BadMap(Module):
    # publishes one latched map whose origin is nowhere
    def setup(self):
        import math
        from robbie_mp.messages import MapMetaData, OccupancyGrid, Point, Pose
        import numpy as np
        origin = Pose(position=Point(x=math.nan))
        nowhere = MapMetaData(resolution=0.05, width=40, height=40, origin=origin)
        grid = OccupancyGrid(info=nowhere, data=np.zeros(1600, np.int8))
        self.publish_encoded(grid.type_name, grid.version, grid.encode(), topic="", latched=True)
"""
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {port: 0, operator_token: file:operator.token, tabs: TABS}
  damager: {class: "zoo.damager:CLASS"}
"""


def start(robot: Robot, name: str, panels: Iterable[str]) -> Attacker:
    """Start a robot with a station that has some panels; return a visitor with its token."""
    (robot.folder / "zoo" / "damage.py").write_text(Path(damage.__file__).read_text())
    (robot.folder / "zoo" / "damager.py").write_text(MODULES)
    robot.write_secret("operator.token", TOKEN)
    tabs = json.dumps(dict.fromkeys(panels, ""))
    robot.write_profile(PROFILE.replace("CLASS", name).replace("TABS", tabs))
    robot.start()
    address_of(robot)
    found = re.search(r":(\d+)/", robot.top()["operator"]["status"])
    assert found
    return Attacker(int(found[1])).log_in(TOKEN)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_station_and_its_panels_survive_every_damaged_field(
    robot: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    visitor = start(robot, "Damager", FRAMEWORK_PANELS)
    document = visitor.open()
    with visitor.connect(document.query) as socket:
        before = robot.top()["operator"]
        heard = [(one["type_name"], one["topic"]) for one in before["subscriptions"]]
        (robot.output / "channels.json").write_text(json.dumps(heard))

        def is_done() -> bool:
            socket.listen(0.2)
            return str(robot.top()["damager"]["status"]).startswith("done")

        robot.until(lambda _modules: is_done())
        after = robot.top()
    with capsys.disabled():
        operator, made = after["operator"], after["damager"]["status"]
        print(f"\n{len(FRAMEWORK_PANELS)} panels: {made}, {operator['ill_formed']} refused")
    assert after["operator"]["pid"] == before["pid"]
    assert after["operator"]["ill_formed"]
    assert "Traceback" not in robot.log("operator")
    visitor.open()


@pytest.mark.slow
def test_page_stays_up_with_a_latched_map_whose_origin_is_nowhere(robot: Robot) -> None:
    visitor = start(robot, "BadMap", ["map"])
    figures = robot.until(lambda modules: bool(modules["operator"]["ill_formed"]))
    document = visitor.open()
    with visitor.connect(document.query) as socket:
        socket.listen(2.0)
    assert robot.top()["operator"]["pid"] == figures["operator"]["pid"]
    assert figures["operator"]["restarts"] == 0
