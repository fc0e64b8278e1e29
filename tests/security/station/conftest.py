"""A robot with an operator station that attackers reach."""

import json
import re
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests._support.left_behind import leaving_nothing_behind
from tests._support.robot import Robot, robot_in
from tests.security.station._support.attacker import Attacker

HERE = Path(__file__).parent
TESTS = HERE.parents[1]
SOURCES = (
    TESTS / "station" / "_support" / "known_robot.py",
    TESTS / "station" / "_support" / "stage.py",
    TESTS / "modules" / "rescue" / "station" / "_support" / "rescuer.py",
    HERE / "_support" / "listener.py",
)
DESCRIPTORS = 512
"""That each process of the robot may have."""
OPERATOR, OBSERVER = "correct-horse-battery", "only-looking-please"
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings:
      port: 0
      operator_token: file:operator.token
      observer_token: file:observer.token
      speech_commands: [come here]
      panels: ["robbie_robots.modules.rescue.station.mission_panel:MissionPanel"]
  listener: {class: "zoo.listener:Listener"}
  link: {class: "robbie_mp.connect.link.module:Link", settings: {robot: red, listen: [], prefix_topics: true}}
  rescuer: {class: "zoo.rescuer:Rescuer"}
  known: {class: "zoo.known_robot:KnownRobot"}
  stage: {class: "zoo.stage:Stage"}
  base: {class: "zoo.modules:StandingBase"}
"""


class Station:
    """An operator station, and what the robot has heard from it."""

    def __init__(self, robot: Robot):
        self.robot = robot
        figures = robot.until(lambda modules: "http://" in modules["operator"]["status"])
        found = re.search(r":(\d+)/", figures["operator"]["status"])
        assert found
        self.port = int(found[1])
        robot.until(lambda modules: all(one["state"] == "RUNNING" for one in modules.values()))
        self._forgotten = 0
        self.starts_before = self.starts

    def forget(self) -> None:
        """Leave out what was heard until now."""
        self._forgotten += len(self.heard)

    def stranger(self, source: str = "127.0.0.1") -> Attacker:
        return Attacker(self.port, source=source)

    def operator(self) -> Attacker:
        return self.stranger().log_in(OPERATOR)

    def observer(self) -> Attacker:
        return self.stranger().log_in(OBSERVER)

    @property
    def heard(self) -> list[tuple[str, bool | None]]:
        """Types of all messages that came from the page; of emergency stops, whether they engage it."""
        lines = (self.robot.output / "heard.txt").read_text().splitlines()
        return [(name, engaged) for name, engaged in map(json.loads, lines[self._forgotten :])]

    @property
    def pid(self) -> int:
        return int(self.robot.top()["operator"]["pid"])

    @property
    def starts(self) -> int:
        """How often the station was started."""
        return int(self.robot.top()["operator"]["incarnation"])


@pytest.fixture(autouse=True)
def nothing_left_behind() -> None:
    """Robots are shared by the tests of a file, and looked at when they have ended."""


@pytest.fixture(scope="module")
def shared_station(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Station]:
    """One robot for all attacks in a file, so the effects of one attack remain for the next."""
    with leaving_nothing_behind(), robot_in(tmp_path_factory.mktemp("security")) as robot:
        for source in SOURCES:
            (robot.folder / "zoo" / source.name).write_text(source.read_text())
        robot.write_secret("operator.token", OPERATOR)
        robot.write_secret("observer.token", OBSERVER)
        robot.write_profile(PROFILE)
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (DESCRIPTORS, hard))
        try:
            robot.start()
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        yield Station(robot)


@pytest.fixture
def station(shared_station: Station) -> Iterator[Station]:
    """The robot, without the messages it received before; the test fails if it restarts the station."""
    shared_station.forget()
    yield shared_station
    figures = shared_station.robot.top().get("operator")
    if figures is None or figures["incarnation"] != shared_station.starts_before:
        pytest.fail(f"the station died: {figures}\n{shared_station.robot.log('operator')[-4000:]}")
