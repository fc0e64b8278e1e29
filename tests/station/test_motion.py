"""The display says how far the way is free, how the robot leans, and why it stands though commanded."""

import time
from collections import deque
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from robbie_mp.messages import (
    ControlState,
    DriveCommand,
    EmergencyStop,
    Header,
    LaserScan,
    Message,
    Odometry,
    Quaternion,
)
from robbie_mp.scene import RigidTransform, SceneGraphListener, UnknownNode
from robbie_mp.station.driving.motion import WITHOUT_GUARD, Movement, RobotMotion, free_way_m, ring_of, tilt
from robbie_mp.station.page.state_item import clock_text
from robbie_mp.station.page.state_strip import time_left_s
from robbie_mp.station.watch.latest import Latest, MessageSource


def now_s() -> float:
    return time.monotonic()  # as the fixture sets it


class Stage:
    """What `RobotMotion` sees of a station."""

    def __init__(self) -> None:
        self.known: dict[tuple[type[Message], str], Latest[Any]] = {}
        self.scene = SimpleNamespace(graph=SimpleNamespace(pose=self._pose))

    def newest(self, message_type: type[Message], topic: str = "") -> Latest[Any]:
        return self.known.setdefault((message_type, topic), Latest(now_s))

    def motion(self) -> RobotMotion:
        messages, scene = cast(MessageSource, self), cast(SceneGraphListener, self.scene)
        return RobotMotion(messages, scene, {"one"}, (0.4, 0.3, 0.2), now_s)

    def _pose(self, *_nodes: str) -> None:
        raise UnknownNode("map")


@pytest.fixture
def time_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


def test_free_way_ahead_is_counted_from_the_front_and_as_wide_as_the_robot() -> None:
    points = np.array([[1.0, 0.0, 0.1], [0.5, 0.2, 0.1], [-0.3, 0.0, 0.1]])
    assert free_way_m(points, length_m=0.4, width_m=0.3, range_max_m=8.0) == pytest.approx(0.8)
    assert free_way_m(points[1:], length_m=0.4, width_m=0.3, range_max_m=8.0) == pytest.approx(7.8)


def test_ring_counts_from_the_robots_edge_and_says_nothing_where_no_laser_looks() -> None:
    points = np.array([[1.0, 0.0, 0.1], [0.0, 0.65, 0.1], [0.7, 0.0, 0.1]])
    looks_rad = np.array([0.0, 0.05, np.pi / 2, -np.pi / 2])
    ring = ring_of(points, looks_rad, length_m=0.4, width_m=0.3, range_max_m=8.0)
    assert ring == pytest.approx((0.5, None, 0.5, None, None, None, 8.0, None))


def test_tilt_is_told_apart_from_heading() -> None:
    assert tilt(Quaternion.from_yaw(1.0)) == pytest.approx((0.0, 0.0))
    assert tilt(Quaternion(x=np.sin(0.1), w=np.cos(0.1))) == pytest.approx((0.0, 0.2))
    assert tilt(Quaternion(y=np.sin(0.1), w=np.cos(0.1))) == pytest.approx((0.2, 0.0))


def test_robot_that_stands_though_commanded_is_reported_with_the_reason(time_s: list[float]) -> None:
    stage = Stage()
    watch = stage.motion()

    def drive(for_s: float, *, unguarded: bool = False) -> str:
        until_s = time_s[0] + for_s
        while time_s[0] < until_s:
            time_s[0] += 0.2
            stage.known[(Odometry, "odom")].put(Odometry())
            watch.command(DriveCommand(linear_m_per_s=0.3, unguarded=unguarded))
            watch.tick()
        return watch.now.hint

    assert drive(0.8) == ""
    assert drive(1.0) == "It is commanded but stands: it is blocked, or the base does not follow"
    control = stage.known[(ControlState, "control")]
    control.put(ControlState(mode=ControlState.HOLD, reason="the emergency stop was released"))
    assert drive(0.4).startswith("It is commanded but holds: the emergency stop was released")
    control.put(ControlState(mode=ControlState.MANUAL, who="operator"))
    assert "the guard stops it" in drive(0.4)
    assert "guard" not in drive(0.4, unguarded=True)
    stage.known[(EmergencyStop, "emergency_stop_state")].put(EmergencyStop(engaged=True))
    assert drive(0.4) == "It is commanded but stands: the emergency stop is engaged"
    assert watch.now.commanded_linear == 0.3
    time_s[0] += 1.0
    watch.tick()
    assert watch.now == Movement(linear_m_per_s=0.0, angular_rad_per_s=0.0, heading_rad=0.0, is_manual=True)
    assert (LaserScan, "") in stage.known
    assert watch.now.ahead_m is None


def test_drive_without_the_guard_is_shown(time_s: list[float]) -> None:
    stage = Stage()
    watch = stage.motion()
    watch.command(DriveCommand(linear_m_per_s=0.3, unguarded=True))
    watch.tick()
    assert watch.now.hint == WITHOUT_GUARD
    time_s[0] += 1.0
    watch.tick()
    assert watch.now.hint == ""


def test_free_way_ahead_is_that_of_all_lasers_together(
    time_s: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = Stage()
    mounts = {
        "base_link": RigidTransform(),
        "laser": RigidTransform(),
        "rear_laser": RigidTransform(qz=1.0, qw=0.0),
    }
    monkeypatch.setattr(stage.scene.graph, "pose", lambda _base, frame: mounts[frame], raising=False)
    watch = stage.motion()

    def see(frame: str, nearest_m: float) -> float | None:
        scan = LaserScan(
            header=Header(frame_id=frame), range_max=8.0, ranges=np.array([nearest_m], np.float32)
        )
        stage.known[(LaserScan, "")].put(scan)
        time_s[0] += 0.2
        watch.tick()
        return watch.now.ahead_m

    assert see("laser", 1.0) == pytest.approx(0.8)
    assert see("rear_laser", 0.5) == pytest.approx(0.8), "it looks back"
    assert see("laser", 2.0) == pytest.approx(1.8)
    time_s[0] += 1.0
    assert see("rear_laser", 0.5) == pytest.approx(7.8), "an old scan does not count"


def test_ring_says_nothing_where_a_laser_is_blind(
    time_s: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = Stage()
    monkeypatch.setattr(stage.scene.graph, "pose", lambda *_: RigidTransform(), raising=False)
    watch = stage.motion()

    def ring(range_m: float) -> tuple[float | None, ...]:
        ranges = np.full(8, range_m, np.float32)
        scan = LaserScan(angle_increment=np.pi / 4, range_min=0.1, range_max=8.0, ranges=ranges)
        stage.known[(LaserScan, "")].put(scan)
        time_s[0] += 0.2
        watch.tick()
        return watch.now.ring_m

    assert ring(np.inf) == pytest.approx((8.0,) * 8), "nothing is near"
    assert ring(1.0)[0] == pytest.approx(0.8)
    for blind in (np.nan, -np.inf, 0.05):
        assert not any(ring(blind)), blind


def test_battery_lasts_as_long_as_its_charge_has_fallen_lately() -> None:
    assert time_left_s(deque([(0.0, 0.5), (100.0, 0.4)])) == pytest.approx(400.0)
    assert time_left_s(deque([(0.0, 0.5), (10.0, 0.4)])) is None, "too short to tell"
    assert time_left_s(deque([(0.0, 0.5), (100.0, 0.6)])) is None, "it is being charged"
    assert [clock_text(seconds) for seconds in (65.4, 7200.0)] == ["1:05", "2 h 00"]
