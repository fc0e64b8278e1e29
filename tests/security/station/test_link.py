"""Without a token in the profile, a station makes one that only the run's user can read."""

import stat
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import psutil
import pytest

from robbie_mp.run.operator_link import LINK_FILE, TOKEN_FILE, read_link
from tests._support.robot import Robot, command_of, kill, wait_until
from tests.security.station._support.attacker import Attacker
from tests.security.station.conftest import Station

pytestmark = pytest.mark.timeout(300)
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {port: 0}
  base: {class: "zoo.modules:StandingBase"}
"""


def test_station_without_a_token_makes_one_that_only_its_user_can_read(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    process = robot.start()
    station = Station(robot)
    stranger = station.stranger()
    assert stranger.ask("/").status == 303, "every user of this machine is an operator"
    assert stranger.ask("/_nicegui/x").status == 401

    folder = robot.known_run().folder
    link = read_link(folder)
    (token,) = parse_qs(urlsplit(link).query)["token"]
    assert len(token) >= 43, "fewer than 256 bits"
    for name in (LINK_FILE, TOKEN_FILE):
        assert stat.S_IMODE((folder / name).stat().st_mode) == 0o600
    assert robot.command("gui", "--link").stdout == f"{link}\n"

    path = link.partition(f":{station.port}")[2]
    answer = stranger.ask(path)
    assert (answer.status, answer.headers["location"]) == (303, "./")
    user = Attacker(station.port, answer.cookie)
    assert user.open().elements
    assert "HttpOnly" in answer.headers["set-cookie"]

    assert token not in robot.top()["operator"]["status"]
    assert token not in robot.log("operator")
    for one in psutil.Process(process.pid).children(recursive=True):
        assert token not in " ".join(command_of(one))
    for written in Path(robot.output).rglob("*"):
        assert not written.is_file() or token.encode() not in written.read_bytes(), written
    assert token not in user.ask("/").body

    kill(station.pid)
    wait_until(lambda: station.starts > station.starts_before)
    robot.until(lambda modules: modules["operator"]["state"] == "RUNNING")
    assert read_link(folder) == link
    assert user.ask("/").status == 200
    process.terminate()
    _, said = process.communicate(timeout=60)
    assert token not in said
    assert "robbie gui --link" in said
