"""The base follows who is in control, and nothing that is old or rests on old measurements."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_mp import CallRefused, Duration, Header, ModuleHarness, Time
from robbie_mp.messages import (
    ControlState,
    DriveCommand,
    EmergencyStop,
    LaserScan,
    Odometry,
    SetControl,
    TFMessage,
    TransformStamped,
)
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.modules.devices import command_age, commanded_base
from robbie_robots.modules.devices.base import SimulatedBase
from tests._support.commands import fresh, waits

ARENA = """\
cell_m: 0.5
drawing: |
  ####################
  #..................#
  #R.................#
  #..................#
  ####################
"""
Base = ModuleHarness[SimulatedBase]


@pytest.fixture
def settings(tmp_path: Path) -> dict[str, object]:
    (tmp_path / "arena.yaml").write_text(ARENA)
    return {"arena": tmp_path / "arena.yaml", "guard_topics": ["scan"]}


@pytest.fixture
def base(settings: dict[str, object]) -> Iterator[Base]:
    with ModuleHarness(SimulatedBase, settings, name="base") as harness:
        harness.advance(10.0)
        yield harness


def send(
    base: Base, topic: str = "", age_s: float = 0.0, unguarded: bool = False, sender: str = "test"
) -> None:
    command = DriveCommand(linear_m_per_s=0.3, valid_for=Duration.from_seconds(0.3), unguarded=unguarded)
    base.send(fresh(base, command, age_s), topic=topic, sender=sender)


def see(
    base: Base,
    ahead_m: float,
    beams: int = 360,
    *,
    topic: str = "scan",
    frame: str = "laser",
    late_s: float = 0.0,
) -> None:
    """Send a scan with a wall ahead."""
    angles = np.linspace(-math.pi, math.pi, beams, endpoint=False)
    ranges = np.where(np.abs(angles) < 0.5, ahead_m, 5.0)
    scan = LaserScan(
        header=Header(stamp=Time.from_nanoseconds(base.clock.now_ns() - round(late_s * 1e9)), frame_id=frame),
        angle_min=-math.pi,
        angle_increment=2 * math.pi / beams,
        range_max=10.0,
        ranges=ranges,
    )
    base.send(scan, topic=topic)


def speed(base: Base) -> float:
    base.advance(0.1)
    return base.take(Odometry, "odom")[-1].twist.twist.linear.x


def mode(base: Base) -> int:
    state = base.latched(ControlState, "control")
    assert state is not None
    return state.mode


def test_command_that_rests_on_old_measurements_is_refused(base: Base) -> None:
    send(base, age_s=0.35)
    assert speed(base) == 0.0
    assert "1 too old" in base.module.status
    send(base, age_s=0.05)
    assert speed(base) > 0.0


def test_new_commands_on_old_measurements_do_not_keep_the_robot_going(base: Base) -> None:
    stamp_ns = base.clock.now_ns()
    speeds = []
    for _ in range(10):  # a module whose laser has stopped goes on commanding
        age_s = (base.clock.now_ns() - stamp_ns) / 1e9
        send(base, age_s=age_s)
        speeds.append(speed(base))
    assert max(speeds[:3]) > 0.2
    assert speeds[3:] == [0.0] * 7  # 0.4 s after the measurement


@pytest.mark.parametrize("held_up", ["before the drive takes it", "while the drive takes it"])
def test_base_that_is_held_up_after_it_has_judged_a_command_does_not_drive_on(
    base: Base, monkeypatch: pytest.MonkeyPatch, held_up: str
) -> None:
    drive, judge = base.module.drive, command_age.left_s
    commands: list[float] = []

    def judged(*arguments: Any) -> float:
        left_s = judge(*arguments)
        base.clock.advance(0.4 * (held_up == "before the drive takes it"))
        return left_s

    def command(linear_m_per_s: float, angular_rad_per_s: float, valid_for_s: float) -> None:
        if not commands:
            base.clock.advance(0.4 * (held_up == "while the drive takes it"))
        commands.append(valid_for_s)
        SimulatedDrive.command(drive, linear_m_per_s, angular_rad_per_s, valid_for_s)

    monkeypatch.setattr(commanded_base, "left_s", judged)
    monkeypatch.setattr(drive, "command", command)
    send(base)
    assert len(commands) == (held_up == "while the drive takes it")
    base.advance(0.3)
    assert max(one.pose.pose.position.x for one in base.take(Odometry, "odom")) == 0.0
    assert "1 too old" in base.module.status


def test_command_that_does_not_say_what_it_rests_on_is_refused(
    base: Base, caplog: pytest.LogCaptureFixture
) -> None:
    base.send(DriveCommand(linear_m_per_s=0.3, valid_for=Duration.from_seconds(0.3)))
    assert speed(base) == 0.0
    assert "it does not say (based_on)" in caplog.text


def test_command_from_the_future_is_refused(base: Base) -> None:
    send(base, age_s=-1.0)
    assert speed(base) == 0.0


def test_command_to_stand_is_followed_however_old(base: Base) -> None:
    send(base)
    assert speed(base) > 0.0
    base.send(DriveCommand())
    base.advance(0.3)
    assert speed(base) == 0.0


def test_driving_by_hand_ends_in_hold_and_an_order_lets_modules_drive_again(base: Base) -> None:
    see(base, 5.0)
    send(base, "manual")
    assert speed(base) > 0.0
    assert mode(base) == ControlState.MANUAL
    base.advance(1.0)
    assert mode(base) == ControlState.HOLD
    send(base)
    assert speed(base) == 0.0
    assert base.call(SetControl(mode=ControlState.AUTO)).mode == ControlState.AUTO
    send(base)
    assert speed(base) > 0.0


def test_of_two_modules_that_drive_the_base_follows_one_and_names_both(
    base: Base, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(20):
        send(base, sender="navigation")
        base.advance(0.05)
        backwards = DriveCommand(linear_m_per_s=-0.3, valid_for=Duration.from_seconds(0.3))
        base.send(fresh(base, backwards), sender="exploration")
        base.advance(0.05)
    assert base.take(Odometry, "odom")[-1].twist.twist.linear.x == pytest.approx(0.3)
    assert "20 not in control" in base.module.status
    assert caplog.text.count("refused a drive command of exploration: navigation drives") == 1
    base.advance(0.5)
    send(base, sender="exploration")
    assert speed(base) > 0.0


def test_released_emergency_stop_does_not_start_the_mission(base: Base) -> None:
    base.send(EmergencyStop(engaged=True, reason="test"), topic="emergency_stop")
    with pytest.raises(CallRefused, match="release it first"):
        base.call(SetControl(mode=ControlState.AUTO))
    base.send(EmergencyStop(engaged=False), topic="emergency_stop")
    for _ in range(20):
        send(base)
        assert speed(base) == 0.0
    assert mode(base) == ControlState.HOLD


def test_restarted_base_still_holds(base: Base, settings: dict[str, object]) -> None:
    base.call(SetControl(mode=ControlState.HOLD, reason="wait"))
    with ModuleHarness(SimulatedBase, settings, restored=base.checkpoint) as again:
        again.advance(0.1)
        send(again)
        assert speed(again) == 0.0
        assert mode(again) == ControlState.HOLD


def test_hold_stops_a_robot_that_drives(base: Base) -> None:
    send(base)
    assert speed(base) > 0.0
    base.call(SetControl(mode=ControlState.HOLD))
    base.advance(0.4)
    assert speed(base) == 0.0


def test_robot_that_starts_in_hold_waits_for_an_order(settings: dict[str, object]) -> None:
    with ModuleHarness(SimulatedBase, settings | {"starts_in_auto": False}) as base:
        base.advance(1.0)
        send(base)
        assert speed(base) == 0.0


@pytest.mark.parametrize("beams", [360, 359, 361])
def test_guard_stops_an_operator_before_a_wall(base: Base, beams: int) -> None:
    see(base, 5.0)
    send(base, "manual")
    assert speed(base) > 0.0
    base.advance(1.0)
    see(base, 0.27, beams)
    send(base, "manual")
    base.advance(0.1)
    assert speed(base) == 0.0


def test_operator_drives_past_the_guard_on_purpose(base: Base) -> None:
    see(base, 0.27)
    send(base, "manual", unguarded=True)
    assert speed(base) > 0.0


def test_blind_guard_lets_nobody_drive_by_hand(base: Base) -> None:
    see(base, 5.0)
    base.advance(0.5)
    send(base, "manual")
    assert speed(base) == 0.0
    assert "too old" in base.module.status


def test_wrong_order_is_refused(base: Base) -> None:
    for wrong in (ControlState.MANUAL, 7):
        with pytest.raises(CallRefused):
            base.call(SetControl(mode=wrong))


def test_order_to_go_on_that_waited_in_a_stopped_base_is_refused(
    base: Base, monkeypatch: pytest.MonkeyPatch
) -> None:
    base.call(SetControl(mode=ControlState.HOLD))
    waits(base, monkeypatch, 5.0)
    with pytest.raises(CallRefused, match="has waited"):
        base.call(SetControl(mode=ControlState.AUTO))
    assert base.call(SetControl(mode=ControlState.HOLD)).mode == ControlState.HOLD


def test_release_that_waited_or_was_kept_for_a_restart_does_nothing(
    base: Base, monkeypatch: pytest.MonkeyPatch
) -> None:
    base.send(EmergencyStop(engaged=True), topic="emergency_stop")
    waits(base, monkeypatch, 5.0)
    base.send(EmergencyStop(engaged=False), topic="emergency_stop")
    assert base.take(EmergencyStop, "emergency_stop_state")[-1].engaged


def test_laser_whose_clock_is_ahead_does_not_keep_the_guard_seeing(base: Base) -> None:
    see(base, 5.0, late_s=-5.0)
    send(base, "manual")
    assert speed(base) == 0.0
    base.advance(2.0)  # it has died, and its last stamp is still to come
    send(base, "manual")
    assert speed(base) == 0.0


def test_old_scan_does_not_become_fresh_when_the_clock_is_set_back(
    base: Base, monkeypatch: pytest.MonkeyPatch
) -> None:
    see(base, 5.0)
    base.advance(3.0)
    monkeypatch.setattr(base.clock, "now_ns", lambda: base.clock.monotonic_ns() - 3_000_000_000)
    send(base, "manual")
    assert speed(base) == 0.0


def test_guard_does_not_guess_where_a_laser_is_mounted(base: Base) -> None:
    see(base, 5.0, frame="rear_laser")
    send(base, "manual")
    assert speed(base) == 0.0
    mount = TransformStamped(header=Header(frame_id="base_link"), child_frame_id="rear_laser")
    base.send(TFMessage(transforms=[mount]), topic="tf_static")
    send(base, "manual")
    assert speed(base) > 0.0


def test_of_several_lasers_without_a_named_topic_all_must_be_fresh(settings: dict[str, object]) -> None:
    with ModuleHarness(SimulatedBase, settings | {"guard_topics": [""]}) as base:
        base.advance(10.0)
        see(base, 5.0, topic="front")
        see(base, 5.0, topic="rear")
        send(base, "manual")
        assert speed(base) > 0.0
        for _ in range(5):  # the one ahead has died
            see(base, 5.0, topic="rear")
            base.advance(0.1)
        send(base, "manual")
        assert speed(base) == 0.0


def test_robot_that_holds_at_the_start_does_so_whatever_an_earlier_run_has_kept(
    base: Base, settings: dict[str, object]
) -> None:
    kept = base.checkpoint
    assert mode(base) == ControlState.AUTO
    with ModuleHarness(SimulatedBase, settings | {"starts_in_auto": False}, restored=kept) as again:
        again.advance(0.1)
        send(again)
        assert speed(again) == 0.0
        assert mode(again) == ControlState.HOLD


def test_base_that_dies_of_a_command_by_hand_remembers_that_an_operator_has_taken_over(
    base: Base, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its next process let the mission go on."""
    see(base, 5.0)
    send(base)
    monkeypatch.setattr(base.module.guard, "checked", lambda *_speeds: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        send(base, "manual")
    assert base.checkpoint["control"]["mode"] == ControlState.MANUAL


def test_emergency_stop_with_an_endless_reason_stops_the_robot_and_outlives_a_restart(base: Base) -> None:
    base.send(EmergencyStop(engaged=True, reason="x" * 1_000_000), topic="emergency_stop")
    (state, *_) = base.take(EmergencyStop, "emergency_stop_state")[-1:]
    assert state.engaged and len(state.reason) <= 200
    with pytest.raises(CallRefused):
        base.call(SetControl(mode=ControlState.AUTO, reason="y" * 1_000_000))
    assert len(str(base.checkpoint)) < 10_000


def test_base_whose_newest_checkpoint_was_damaged_stands_until_it_is_released_and_ordered_to_go_on(
    base: Base, settings: dict[str, object]
) -> None:
    kept = base.checkpoint  # of a time before the emergency stop
    with ModuleHarness(SimulatedBase, settings, restored=kept, checkpoint_lost=True) as again:
        again.advance(0.1)
        assert mode(again) == ControlState.HOLD
        (state, *_) = again.take(EmergencyStop, "emergency_stop_state")[-1:]
        assert state.engaged and "damaged" in state.reason
        see(again, 5.0)
        send(again, "manual")
        assert speed(again) == 0.0
        again.send(EmergencyStop(engaged=False), topic="emergency_stop")
        send(again)
        assert speed(again) == 0.0
        again.call(SetControl(mode=ControlState.AUTO))
        send(again)
        assert speed(again) > 0.0
