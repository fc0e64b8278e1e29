"""The modules of the simulated devices publish the data of their devices as ROS messages."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_mp import CallRefused, Duration, Header, Module, ModuleHarness, SettingError, Time
from robbie_mp.messages import (
    BatteryState,
    Bumper,
    CameraInfo,
    ControlState,
    DriveCommand,
    EmergencyStop,
    Image,
    Imu,
    JointCommand,
    JointLimits,
    JointState,
    LaserScan,
    Odometry,
    PanTiltCommand,
    SetControl,
    SimulatedWorld,
    replace,
)
from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.camera import SimulatedCamera
from robbie_robots.modules.devices.base import SimulatedBase
from robbie_robots.modules.devices.battery import SimulatedBatteryModule
from robbie_robots.modules.devices.bumper import SimulatedBumperModule
from robbie_robots.modules.devices.camera import (
    SimulatedCameraModule,
    SimulatedRearCameraModule,
    SimulatedThermalCameraModule,
)
from robbie_robots.modules.devices.imu import SimulatedImuModule
from robbie_robots.modules.devices.joints import SimulatedJointsModule
from robbie_robots.modules.devices.laser import SimulatedLaserRangeFinder
from robbie_robots.modules.devices.pan_tilt import SimulatedPanTiltModule
from robbie_robots.modules.devices.simulated_world import MoveDoor, SimulatedDoors
from tests._support.commands import fresh

# A corridor along x; the robot starts at (0.75, 0.75). A box comes in front of it after 2 s, before a victim.
ARENA = """\
cell_m: 0.5
drawing: |
  ############
  #R.........#
  ############
victims: [{tag: 5, x_m: 5.5, y_m: 0.75, facing_rad: 3.14159}]
appearing: [{box: [2.0, 0.6, 2.2, 0.9], from_s: 2.0}]
"""


@pytest.fixture
def settings(tmp_path: Path) -> dict[str, object]:
    (tmp_path / "arena.yaml").write_text(ARENA)
    return {"arena": tmp_path / "arena.yaml"}


@pytest.fixture
def base(settings: dict[str, object]) -> Iterator[ModuleHarness[SimulatedBase]]:
    with ModuleHarness(SimulatedBase, settings, name="base") as harness:
        yield harness


def drive(base: ModuleHarness[SimulatedBase], seconds: float, linear: float, angular: float = 0.0) -> None:
    """Command at 10 Hz."""
    for _ in range(round(seconds * 10)):
        valid = Duration.from_seconds(0.3)
        command = DriveCommand(linear_m_per_s=linear, angular_rad_per_s=angular, valid_for=valid)
        base.send(fresh(base, command))
        base.advance(0.1)


def tell(base: ModuleHarness[SimulatedBase], *devices: ModuleHarness[Any]) -> Odometry:
    """Pass on the base's messages about the world. Return the newest true state."""
    told = [entry for entry in base.published if entry.topic == "ground_truth"]
    base.published.clear()
    for message, topic in told:
        for device in devices:
            device.send(message, topic=topic)
    return next(m for m, _ in reversed(told) if isinstance(m, Odometry))


def test_imu_has_a_sample_for_each_pose_and_its_turns_add_up(
    base: ModuleHarness[SimulatedBase], settings: dict[str, object]
) -> None:
    with ModuleHarness(SimulatedImuModule, settings) as imu:
        drive(base, 2.0, 0.2, 0.5)
        truth = tell(base, imu)
        samples = imu.take(Imu, "imu")
    assert len(samples) == 40
    assert samples[-1].header.stamp == truth.header.stamp
    turned = sum(sample.angular_velocity.z * 0.05 for sample in samples)
    assert turned == pytest.approx(truth.pose.pose.orientation.yaw, abs=0.02)
    assert samples[-1].linear_acceleration.z == pytest.approx(9.81, abs=0.3)
    assert samples[-1].orientation_covariance[0] == -1.0


def test_battery_is_drained_and_keeps_its_charge_over_a_restart(
    base: ModuleHarness[SimulatedBase], settings: dict[str, object]
) -> None:
    settings |= {"capacity_ah": 0.02}
    with ModuleHarness(SimulatedBatteryModule, settings) as battery:
        battery.advance(0.0)
        assert not battery.published
        drive(base, 4.0, 0.0, 1.0)
        tell(base, battery)
        battery.advance(1.0)
        state = battery.take(BatteryState, "battery")[-1]
    # 26 W at some 16 V for 4 s.
    assert 1.0 - state.percentage == pytest.approx(26 / 16.4 * 4 / 3600 / 0.02, rel=0.05)
    assert state.current == pytest.approx(-26 / 16, rel=0.1)
    assert state.charge / state.capacity == pytest.approx(state.percentage)
    with ModuleHarness(SimulatedBatteryModule, settings, restored=battery.checkpoint) as again:
        drive(base, 1.0, 0.0)
        tell(base, again)
        again.advance(1.0)
        assert again.take(BatteryState)[-1].percentage < state.percentage


def test_base_stops_when_the_battery_is_empty(base: ModuleHarness[SimulatedBase]) -> None:
    base.send(BatteryState(percentage=0.0), topic="battery")
    drive(base, 1.0, 0.3)
    assert tell(base).pose.pose.position.x == 0.0


def test_emergency_stop_is_confirmed_and_kept_before_anything_else_happens(
    base: ModuleHarness[SimulatedBase], settings: dict[str, object]
) -> None:
    base.take(EmergencyStop)
    base.send(EmergencyStop(engaged=True), topic="emergency_stop")
    assert base.take(EmergencyStop, "emergency_stop_state")[-1].engaged
    with ModuleHarness(SimulatedBase, settings, restored=base.checkpoint) as again:
        assert again.module.drive.is_emergency_stopped


def test_emergency_stop_latches_is_published_and_outlives_the_base(
    base: ModuleHarness[SimulatedBase], settings: dict[str, object]
) -> None:
    base.send(EmergencyStop(engaged=True, reason="somebody pressed the button"), topic="emergency_stop")
    drive(base, 1.0, 0.3)
    state = base.take(EmergencyStop, "emergency_stop_state")[-1]
    assert (state.engaged, state.reason) == (True, "somebody pressed the button")
    assert tell(base).pose.pose.position.x == 0.0
    with ModuleHarness(SimulatedBase, settings, restored=base.checkpoint) as again:
        drive(again, 1.0, 0.3)
        assert again.take(EmergencyStop, "emergency_stop_state")[-1].engaged
        assert tell(again).pose.pose.position.x == 0.0
        again.send(EmergencyStop(engaged=False), topic="emergency_stop")
        again.call(SetControl(mode=ControlState.AUTO))
        drive(again, 1.0, 0.3)
        assert not again.take(EmergencyStop, "emergency_stop_state")[-1].engaged
        assert tell(again).pose.pose.position.x > 0.2


def test_appearing_box_stops_the_robot_and_all_devices_see_it(
    base: ModuleHarness[SimulatedBase], settings: dict[str, object]
) -> None:
    with (
        ModuleHarness(SimulatedLaserRangeFinder, settings | {"noise_m": 0.0}) as laser,
        ModuleHarness(SimulatedBumperModule, settings) as bumper,
        ModuleHarness(SimulatedCameraModule, settings | {"noise": 0.0}) as camera,
    ):
        devices = (laser, bumper, camera)
        seen = []
        for seconds, linear in [(1.0, 0.0), (1.5, 0.0), (4.0, 0.4)]:
            drive(base, seconds, linear)
            truth = tell(base, *devices)
            for device in devices:
                device.advance(0.1)
            seen.append(
                (
                    laser.take(LaserScan)[-1].ranges[180],
                    bumper.take(Bumper, "bumper")[-1].pressed,
                    camera.take(Image, "camera")[-1],
                )
            )
    assert truth.pose.pose.position.x == pytest.approx(2.0 - 0.2 - 0.75, abs=0.01)
    assert [scan for scan, _, _ in seen] == pytest.approx([4.75, 1.25, 0.2], abs=0.01)
    assert [pressed for _, pressed, _ in seen] == [[], [], ["front_left", "front_right"]]
    images = [image.data.reshape(240, 320, 3).astype(int) for _, _, image in seen]
    assert np.abs(images[0] - images[1]).max() > 100
    assert seen[-1][2].header.stamp == truth.header.stamp


@pytest.mark.parametrize(
    "module", [SimulatedBase, SimulatedLaserRangeFinder, SimulatedCameraModule, SimulatedBatteryModule]
)
def test_mistake_in_the_arena_is_found_before_anything_starts(module: type[Module], tmp_path: Path) -> None:
    (tmp_path / "broken.yaml").write_text(ARENA.replace("tag: 5", "tag: 99"))
    with pytest.raises(SettingError, match=r"broken\.yaml:6: tag must be"):
        ModuleHarness(module, {"arena": tmp_path / "broken.yaml"})


def test_base_publishes_obstacles_only_if_the_arena_has_any(
    base: ModuleHarness[SimulatedBase], tmp_path: Path
) -> None:
    base.advance(0.1)
    assert base.take(SimulatedWorld, "ground_truth")
    (tmp_path / "plain.yaml").write_text(ARENA[: ARENA.index("appearing")])
    with ModuleHarness(SimulatedBase, {"arena": tmp_path / "plain.yaml"}) as plain:
        plain.advance(0.1)
        assert not plain.take(SimulatedWorld)


def test_second_laser_measures_from_its_own_place_in_its_own_frame(
    base: ModuleHarness[SimulatedBase], settings: dict[str, object]
) -> None:
    rear = {"frame_id": "rear_laser", "mount": [-0.15, 0.0, math.pi], "noise_m": 0.0, "steps": 1}
    rear |= {"angle_min_rad": 0.0}
    with ModuleHarness(
        SimulatedLaserRangeFinder, settings | rear, name="rear_laser", topics={"": "rear_scan"}
    ) as laser:
        base.advance(0.1)
        tell(base, laser)
        laser.advance(0.1)
        scan = laser.take(LaserScan, "rear_scan")[-1]
    assert scan.header.frame_id == "rear_laser"
    assert scan.ranges == pytest.approx([0.1])  # the wall is 0.25 m behind the middle of the robot
    with (
        pytest.raises(SettingError, match=r"expected x, y \(m\) and heading"),
        ModuleHarness(SimulatedLaserRangeFinder, settings | {"mount": [1.0, 2.0]}),
    ):
        pass


def test_doors_of_the_world_are_moved_by_a_request_and_seen_by_the_laser(tmp_path: Path) -> None:
    door = "doors: [{name: cellar, leaf: [3.0, 1.0, 3.0, 2.0], opens_rad: 1.5708}]\n"
    (tmp_path / "house.yaml").write_text(ARENA[: ARENA.index("victims")] + door)
    settings: dict[str, object] = {"arena": tmp_path / "house.yaml"}
    with (
        ModuleHarness(SimulatedBase, settings) as base,
        ModuleHarness(SimulatedLaserRangeFinder, settings) as laser,
    ):
        base.call(MoveDoor(door="cellar", open=True))
        for _ in range(30):
            base.advance(0.1)
        (moved,) = base.take(SimulatedDoors, "ground_truth")[-1:]
        assert moved.opened == pytest.approx([1.5708])
        laser.send(moved, topic="ground_truth")
        assert laser.module.world.arena.segments[-1] == pytest.approx([3.0, 1.0, 2.0, 1.0], abs=1e-4)
        with pytest.raises(CallRefused, match="there is no door 'attic'; there are: cellar"):
            base.call(MoveDoor(door="attic", open=True))


def test_cameras_follow_the_pan_tilt_unit_and_publish_their_projection(
    base: ModuleHarness[SimulatedBase], settings: dict[str, object]
) -> None:
    with (
        ModuleHarness(SimulatedCameraModule, settings) as camera,
        ModuleHarness(SimulatedThermalCameraModule, settings) as thermal,
        ModuleHarness(SimulatedPanTiltModule) as unit,
    ):
        camera.advance(0.0)
        assert not camera.published
        warm = []
        for pan in (0.0, 0.9):
            unit.send(fresh(unit, PanTiltCommand(pan_rad=pan)))
            unit.advance(0.5)
            joints = unit.take(JointState, "pan_tilt")[-1]
            assert (list(joints.name), joints.position[0]) == (["pan", "tilt"], pan)
            base.advance(0.6)
            tell(base, camera, thermal)
            for device in (camera, thermal):
                device.send(joints, topic="pan_tilt")
                device.advance(0.1)
            heat = thermal.take(Image, "thermal")[-1]
            assert (heat.encoding, heat.step, heat.header.frame_id) == ("mono16", 320, "thermal_optical")
            warm.append(int((heat.data.view("<u2") > 30000).sum()))
        image, info = camera.take(Image, "camera")[-1], camera.take(CameraInfo, "camera")[-1]
    assert warm[0] > 20 and warm[1] == 0
    assert (image.encoding, image.step, len(image.data)) == ("rgb8", 960, 320 * 240 * 3)
    assert image.header == info.header
    assert camera.latched(CameraInfo, "camera") == info
    focal = 160 / math.tan(1.047 / 2)
    np.testing.assert_allclose(info.k, [focal, 0, 159.5, 0, focal, 119.5, 0, 0, 1])
    np.testing.assert_allclose(info.p.reshape(3, 4)[:, :3].ravel(), info.k)


@pytest.mark.parametrize(
    ("told", "pan"),
    [
        ([(-0.05, 0.1, 2.0), (0.05, 0.3, 2.0), (0.09, 0.9, 0.0)], 0.2),
        ([(-0.15, 0.0, 2.0), (-0.05, 0.1, 2.0)], 0.2),
        ([(-5.0, 0.0, 2.0)], 0.2),
        ([(-5.0, 0.2, 0.0)], 0.2),
    ],
    ids=["between", "turning on", "long ago", "at rest"],
)
def test_image_shows_the_direction_at_its_stamp(
    base: ModuleHarness[SimulatedBase],
    settings: dict[str, object],
    told: list[tuple[float, float, float]],
    pan: float,
) -> None:
    base.advance(0.1)
    with ModuleHarness(SimulatedCameraModule, settings | {"noise": 0.0}) as camera:
        truth = tell(base, camera)
        for after_s, position, rate in told:
            stamp = Time.from_nanoseconds(truth.header.stamp.nanoseconds + round(after_s * 1e9))
            joints = JointState(
                header=Header(stamp=stamp),
                name=["tilt", "pan"],
                position=np.array([0.0, position]),
                velocity=np.array([0.0, rate]),
            )
            camera.send(joints, topic="pan_tilt")
        for name, angles in [
            (["wheel"], [1.0]),
            (["pan", "tilt"], [math.nan, 0.0]),
            (["pan", "tilt"], [1.0]),
        ]:
            camera.send(JointState(name=name, position=np.array(angles)), topic="pan_tilt")
        camera.advance(0.0)
        (image,) = camera.take(Image, "camera")
    there = SimulatedCamera(read_arena(str(settings["arena"])), CameraGeometry(320, 240, 1.047), noise=0.0)
    there.look(pan, 0.0)
    there.place(Pose(0.75, 0.75, 0.0), 0.0)
    difference = np.abs(there.capture().pixels.ravel().astype(int) - image.data)
    assert (difference > 0).mean() < 0.01


def test_restarted_pan_tilt_unit_keeps_its_direction() -> None:
    with ModuleHarness(SimulatedPanTiltModule) as unit:
        unit.send(fresh(unit, PanTiltCommand(pan_rad=0.5, tilt_rad=math.nan)))
        unit.send(fresh(unit, PanTiltCommand(pan_rad=0.5, tilt_rad=-0.1)))
        unit.advance(1.0)
    with ModuleHarness(SimulatedPanTiltModule, restored=unit.checkpoint) as again:
        again.advance(0.0)
        (joints,) = again.take(JointState)
    assert joints.position.tolist() == pytest.approx([0.5, -0.1])


def test_pan_tilt_unit_is_moved_by_hand_and_stops_when_the_command_expires() -> None:
    with ModuleHarness(SimulatedPanTiltModule) as unit:
        (limits,) = unit.take(JointLimits, "pan_tilt")
        assert (limits.name, limits.lower.tolist(), limits.upper.tolist()) == (
            ["pan", "tilt"],
            [-2.6, -0.8],
            [2.6, 0.8],
        )
        held = JointCommand(
            name=["pan"], position=np.array([2.0]), valid_for=Duration.from_nanoseconds(220_000_000)
        )
        unit.send(fresh(unit, held), topic="pan_tilt")
        unit.advance(2.0)
        stopped = unit.take(JointState, "pan_tilt")[-1].position.tolist()
        assert stopped == pytest.approx([2.0 * 0.22, 0.0], abs=2.0 * 0.06)
        unit.send(fresh(unit, PanTiltCommand(pan_rad=-0.5, tilt_rad=0.3)))  # which does not expire
        unknown = JointCommand(name=["arm"], position=np.array([1.0]), valid_for=held.valid_for)
        unit.send(fresh(unit, unknown), topic="pan_tilt")
        unit.advance(2.0)
        assert unit.take(JointState, "pan_tilt")[-1].position.tolist() == pytest.approx([-0.5, 0.3])


Unit = ModuleHarness[SimulatedPanTiltModule]


@pytest.fixture
def unit() -> Iterator[Unit]:
    with ModuleHarness(SimulatedPanTiltModule, name="pan_tilt") as harness:
        harness.advance(10.0)
        yield harness


def look(unit: Unit, pan: float) -> None:
    unit.send(fresh(unit, PanTiltCommand(pan_rad=pan, valid_for=Duration(sec=1))))


def turn(unit: Unit, pan: float) -> float:
    """Turn the unit by hand for a while; return where it is then."""
    valid_for = Duration.from_seconds(0.17)
    for _ in range(4):
        by_hand = JointCommand(name=["pan"], position=np.array([pan]), valid_for=valid_for, by_hand=True)
        unit.send(fresh(unit, by_hand), topic="pan_tilt", sender="page")
        unit.advance(0.05)
    return pan_of(unit)


def pan_of(unit: Unit) -> float:
    return float(unit.take(JointState, "pan_tilt")[-1].position[0])


def tell_control(unit: Unit, mode: int) -> None:
    unit.send(ControlState(mode=mode, who="page"), topic="control", sender="base")


def tell_stop(unit: Unit, engaged: bool) -> None:
    unit.send(EmergencyStop(engaged=engaged), topic="emergency_stop_state")


@pytest.mark.parametrize("by", ["stop", "hold"])
def test_pan_tilt_unit_stops_at_once_and_looks_where_a_module_wants_when_the_robot_goes_on(
    unit: Unit, by: str
) -> None:
    look(unit, 2.0)
    unit.advance(0.2)
    if by == "stop":
        tell_stop(unit, True)
    tell_control(unit, ControlState.HOLD)
    unit.advance(1.0)
    stopped = pan_of(unit)
    assert stopped < 0.7
    look(unit, -1.0)
    unit.advance(1.0)
    tell_stop(unit, False)
    unit.advance(1.0)
    tell_control(unit, ControlState.AUTO)
    unit.advance(1.0)
    assert pan_of(unit) == pytest.approx(stopped), "what was ordered during the stop has expired"
    look(unit, -1.0)
    unit.advance(2.0)
    assert pan_of(unit) == pytest.approx(-1.0)


def test_operator_turns_the_pan_tilt_unit_while_the_robot_holds_but_not_during_an_emergency_stop(
    unit: Unit,
) -> None:
    tell_control(unit, ControlState.HOLD)
    assert turn(unit, 2.0) > 0.2
    tell_stop(unit, True)
    stopped = turn(unit, 2.0)
    assert turn(unit, 2.0) == pytest.approx(stopped, abs=0.01)
    tell_stop(unit, False)
    assert turn(unit, 2.0) == pytest.approx(stopped, abs=0.01), "it was held since before the stop"
    unit.advance(0.6)
    assert turn(unit, 2.0) > stopped + 0.2


def test_module_turns_the_pan_tilt_unit_back_when_the_operator_has_let_go(unit: Unit) -> None:
    tell_control(unit, ControlState.AUTO)
    look(unit, -1.0)
    unit.advance(1.0)
    turn(unit, 1.0)
    look(unit, -0.9)
    assert turn(unit, 1.0) > -0.4
    assert not unit.take(SetControl), "the robot goes on while its operator looks around"
    look(unit, -0.9)  # as modules do twice a second
    unit.advance(2.0)
    assert pan_of(unit) == pytest.approx(-0.9)


def test_pan_tilt_unit_does_not_begin_to_turn_after_a_stop(unit: Unit) -> None:
    look(unit, 2.0)
    tell_stop(unit, True)
    unit.advance(1.0)
    assert pan_of(unit) == pytest.approx(0.0, abs=0.01)


HOUR = Duration(sec=3600)


@pytest.mark.parametrize(
    ("device", "topic", "long"),
    [
        (SimulatedJointsModule, "arm", JointCommand(name=["pan"], position=np.ones(1), valid_for=HOUR)),
        (SimulatedPanTiltModule, "pan_tilt", JointCommand(name=["pan"], position=np.ones(1), valid_for=HOUR)),
        (SimulatedPanTiltModule, "", PanTiltCommand(pan_rad=1.0, valid_for=HOUR)),
    ],
)
def test_command_of_an_hour_is_refused_and_counted_where_the_motors_are(
    device: type[Module], topic: str, long: JointCommand | PanTiltCommand
) -> None:
    settings = {"names": ["pan"]} if device is SimulatedJointsModule else {}
    with ModuleHarness(device, settings, name=topic or "pan_tilt") as harness:
        harness.send(fresh(harness, long), topic=topic)
        harness.send(fresh(harness, replace(long, valid_for=Duration(sec=1))), topic=topic)
        assert harness.bus.subscriptions.refusals.total == 1


def command(base: ModuleHarness[SimulatedBase], linear: float, topic: str = "", valid_s: float = 0.3) -> None:
    valid_for = Duration.from_nanoseconds(round(valid_s * 1e9))
    base.send(fresh(base, DriveCommand(linear_m_per_s=linear, valid_for=valid_for)), topic=topic)


def speed(base: ModuleHarness[SimulatedBase]) -> float:
    return base.take(Odometry, topic="odom")[-1].twist.twist.linear.x


def test_drive_stops_soon_after_its_last_command_has_expired(base: ModuleHarness[SimulatedBase]) -> None:
    for _ in range(10):
        command(base, 0.7, "manual", 0.22)
        base.advance(0.1)
    assert speed(base) == pytest.approx(0.7)
    base.advance(0.25)  # since a tick after the last command: 0.35 s since that, two of them until it expired
    assert speed(base) == 0


def test_command_that_expired_while_it_waited_is_ignored(
    base: ModuleHarness[SimulatedBase], monkeypatch: pytest.MonkeyPatch
) -> None:
    base.advance(0.5)
    envelope = base.bus.envelope
    monkeypatch.setattr(base.bus, "envelope", lambda: envelope()._replace(published_ns=100_000_000))
    command(base, 0.5, valid_s=0.3)
    base.advance(0.2)
    assert speed(base) == 0
    command(base, 0.5, valid_s=1.0)
    base.advance(0.2)
    assert speed(base) > 0


def test_rear_camera_sees_the_victim_behind_the_robot_wherever_the_pan_tilt_unit_looks(
    tmp_path: Path, base: ModuleHarness[SimulatedBase]
) -> None:
    # The robot stands as in ARENA, with a victim at the wall behind it and none ahead.
    behind = ARENA.replace("x_m: 5.5, y_m: 0.75, facing_rad: 3.14159", "x_m: 0.5, y_m: 0.75, facing_rad: 0.0")
    (tmp_path / "behind.yaml").write_text(behind)
    without = tmp_path / "without.yaml"
    without.write_text("".join(line for line in ARENA.splitlines(keepends=True) if "victims" not in line))
    images = []
    for file in (tmp_path / "behind.yaml", without):
        plain = {"arena": file, "noise": 0.0}
        with ModuleHarness(SimulatedRearCameraModule, plain, name="rear") as rear:
            drive(base, 0.1, 0.0)
            tell(base, rear)
            rear.advance(0.0)
            image = rear.take(Image, "rear_camera")[-1]
            assert image.header.frame_id == "rear_camera_optical"
            images.append(image.data.reshape(image.height, image.width, 3).copy())
    assert (images[0] != images[1]).any()
