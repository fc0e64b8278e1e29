"""Through a slow network, no old velocity from Foxglove drives the robot, and its user is told why."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from robbie_mp.connect.foxglove.frames import PongReader, ping
from robbie_mp.messages import Twist, Vector3
from tests._support.delaying_proxy import DelayingProxy, delaying_proxy
from tests._support.robot import Robot, wait_until
from tests.connect.foxglove._support.foxglove_client import Client, connected
from tests.station.test_driving import Journal, start_in_hall

PROFILE = """
modules:
  foxglove:
    class: robbie_mp.connect.foxglove.module:FoxgloveServer
    settings: {port: 0, accept: {/cmd_vel: "Twist as DriveCommand manual"}}
  base: {class: "robbie_robots.modules.devices.base:SimulatedBase", settings: {arena: arena.yaml}}
  witness: {class: "zoo.witness:Witness"}
"""
AHEAD = Twist(linear=Vector3(x=0.3)).encode()
PERIOD_S = 0.1
STANDS_WITHIN_S = 0.4
BRAKES_WITHIN_S = 0.15
"""Braking, and a period of the base's odometry."""

live = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(300)]


class Panel:
    """Foxglove's Teleop panel, far away."""

    def __init__(self, client: Client, proxy: DelayingProxy):
        self.client = client
        self.proxy = proxy
        client.advertise(1, "/cmd_vel", "geometry_msgs/msg/Twist")

    def drive(self, for_s: float) -> float:
        """Hold the button for some time; return when it was let go."""
        until_s = time.monotonic() + for_s
        while time.monotonic() < until_s:
            self.client.publish(1, AHEAD)
            time.sleep(PERIOD_S)
        return time.monotonic()

    def is_told(self) -> None:
        """Wait until the user is told."""
        self.client.until(lambda: any("delay of the network" in one for one in self.client.problems()))


@contextmanager
def far_panel(robot: Robot, delay_s: float = 0.0) -> Iterator[tuple[Panel, Journal]]:
    """Run a robot in a long hall, and a panel at the other end of a delaying proxy."""
    start_in_hall(robot, PROFILE)
    robot.until(lambda modules: "ws://" in modules["foxglove"]["status"])
    address, _, token = robot.command("foxglove").stdout.strip().partition("/?")
    with (
        delaying_proxy(int(address.rpartition(":")[2]), delay_s) as proxy,
        connected(f"ws://127.0.0.1:{proxy.port}/?{token}") as client,
    ):
        yield Panel(client, proxy), Journal(robot)


def driven(journal: Journal) -> list[float]:
    """Return when the robot moved."""
    return [row[0] for row in journal.rows("odometry") if row[2] > 0.0]


@pytest.mark.parametrize("delay_s", [0.3, 2.5])
class TestSlowNetwork:
    pytestmark = live

    def test_panel_that_is_too_far_away_never_drives_the_robot(self, robot: Robot, delay_s: float) -> None:
        with far_panel(robot, delay_s) as (panel, journal):
            panel.drive(2 * delay_s + 2.0)
            time.sleep(delay_s + 0.5)  # what is under way arrives
            assert driven(journal) == []
            panel.is_told()

    def test_robot_stands_soon_when_the_network_becomes_slow_while_it_drives(
        self, robot: Robot, delay_s: float
    ) -> None:
        with far_panel(robot) as (panel, journal):
            panel.drive(1.0)
            let_go_s = panel.drive(1.0)
            wait_until(lambda: journal.speed() == 0)
            assert 0 < driven(journal)[-1] - let_go_s <= STANDS_WITHIN_S + BRAKES_WITHIN_S
            slow_s = panel.drive(0.5)
            panel.proxy.delay_s = delay_s
            panel.drive(2.0)
            time.sleep(delay_s + 0.5)  # what is under way arrives
            assert driven(journal)[-1] - slow_s <= STANDS_WITHIN_S + BRAKES_WITHIN_S
            panel.is_told()


@pytest.mark.parametrize("piece_bytes", [1, 3, 7, 1000])
def test_answers_to_pings_are_found_however_the_stream_is_cut(piece_bytes: int) -> None:
    mask = b"\x07\xff\x00\x5a"
    numbers = [0, 1, 2**64 - 1]
    pongs = []
    for number in numbers:
        content = ping(number)[2:]
        masked = bytes(byte ^ mask[index % 4] for index, byte in enumerate(content))
        pongs.append(b"\x8a\x88" + mask + masked)
    empty, other = b"\x8a\x80" + mask, b"\x8a\x83" + mask + b"abc"
    large = b"\x82\xfe" + (300).to_bytes(2, "big") + mask + pongs[0] * 22
    stream = pongs[0] + empty + other + pongs[1] + large[: 8 + 300] + pongs[2]
    reader = PongReader()
    found = [
        number
        for at in range(0, len(stream), piece_bytes)
        for number in reader.feed(stream[at : at + piece_bytes])
    ]
    assert found == numbers
