"""Emulated devices on pseudo-terminals, with the simulated world behind them.

The drivers for real hardware connect to them as to a real device: every measurement and every command
crosses a serial line as bytes.
"""

import math
from abc import abstractmethod
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robbie_mp import Module, SettingError, Time, setting
from robbie_robots.hw.drive import DriveState
from robbie_robots.hw.emulation.body import SimulatedBody
from robbie_robots.hw.emulation.carrier import PseudoTerminal
from robbie_robots.hw.emulation.create import EmulatedCreate
from robbie_robots.hw.emulation.device import EmulatedDevice
from robbie_robots.hw.emulation.faults import Faults
from robbie_robots.hw.emulation.line import BITS_PER_BYTE, EmulatedLine
from robbie_robots.hw.emulation.p2os import BIT_RATES, EmulatedPioneer, PioneerState
from robbie_robots.hw.emulation.scip import UTM_30LX, EmulatedHokuyo
from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pose import Pose, wrapped
from robbie_robots.hw.simulation.bumper import SimulatedBumper
from robbie_robots.hw.simulation.differential_drive import CREATE_2, DifferentialDrive
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.modules.devices.offered_port import offered_port
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice
from robbie_robots.modules.devices.true_base import TrueBase, state_of

FRONT = ("front_left", "front_right")
REAR = ("back_left", "back_right")
# Two readings of clocks within this time are one; it is tried so often.
AT_ONCE_NS, READINGS = 100_000, 10
KEPT_TRUTHS = 50
# A busy machine may bring the robot's true pose late: so long a sweep waits for it.
MAX_TRUTH_WAIT_S = 0.3


class EmulatedDeviceModule(Module):
    """A module that emulates a device on a pseudo-terminal, in real time.

    The module of the driver finds it at port `run:NAME`, with the name of this module. A subclass calls
    `plug_in` in `setup`.
    """

    line: EmulatedLine | None = None

    jitter_s: float = setting(0.0, "each frame is late by a random time up to this", minimum=0.0, maximum=1.0)
    bit_error_rate: float = setting(0.0, "share of bits that arrive wrong", minimum=0.0, maximum=0.1)
    virtual_plug: bool = setting(True, "whether the device is plugged in", changeable=True)

    def plug_in(self, device: EmulatedDevice, bytes_per_s: float | None = None) -> None:
        """Switch the device on and offer its port.

        Args:
            device: the device.
            bytes_per_s: speed of its line; None: bytes take no time.
        """
        link = offered_port(self.output_directory, self.name)
        link.parent.mkdir(exist_ok=True)
        link.unlink(missing_ok=True)  # a killed predecessor has left it
        faults = Faults(jitter_s=self.jitter_s, bit_error_rate=self.bit_error_rate, bytes_per_s=bytes_per_s)
        self.line = EmulatedLine(device, PseudoTerminal(link), faults)
        self.line.__enter__()
        self.setting_changed("virtual_plug")

    def setting_changed(self, _name: str) -> None:
        """Pull the plug, or plug it in again."""
        if self.line is not None:
            (self.line.plug_in if self.virtual_plug else self.line.unplug)()

    def pull_out(self) -> None:
        """Switch the device off and take its port away."""
        if self.line is not None:
            self.line.__exit__(None, None, None)
            self.line = None

    def run_time_s(self, monotonic_s: float) -> float:
        """Return what the run's time was at a moment of the clock that never goes back.

        A busy machine may stop this process between the readings of both clocks: then it reads them again.
        """
        clock = self.clock
        for _ in range(READINGS):
            before_ns, now_ns, after_ns = clock.monotonic_ns(), clock.now_ns(), clock.monotonic_ns()
            if after_ns - before_ns < AT_ONCE_NS:
                break
        return now_ns / 1e9 - (before_ns / 1e9 - monotonic_s)

    @property
    def line_status(self) -> str:
        """Return a status line on what the line has lost."""
        assert self.line is not None
        plug = "plugged in" if self.line.is_plugged_in else "UNPLUGGED"
        return f"{plug}, {self.line.way.damaged} damaged frames, {self.line.dropped_bytes} dropped bytes"


class EmulatedBase(TrueBase, EmulatedDeviceModule):
    """A base on a serial line that moves a simulated robot through an arena.

    Publishes what `SimulatedBase` publishes on `ground_truth`. After a restart the robot is at rest where it
    was at the last tick, and its controller has just been switched on.
    """

    period_s: float = setting(0.02, "time between messages of the true pose", minimum=0.005)

    def setup(self) -> None:
        """Put the robot into the arena and plug the base in."""
        shape = self.shape()
        self.enter_arena(shape)
        self.body = SimulatedBody(self.drive, shape)
        self.bumper = SimulatedBumper(self.world, shape.body_radius_m)
        device = self.create_device(self.body)
        # The driver takes off the time that a frame takes on the line.
        self.plug_in(device, device.bit_rate / BITS_PER_BYTE if device.bit_rate else None)

    @abstractmethod
    def shape(self) -> DifferentialDrive:
        """Return the robot's geometry and limits."""

    @abstractmethod
    def create_device(self, body: SimulatedBody) -> EmulatedDevice:
        """Return the base's controller."""

    @abstractmethod
    def press(self, parts: tuple[str, ...]) -> None:
        """Let the base's bumpers feel contacts."""

    def tick(self) -> None:
        """Publish and checkpoint the true pose; let the bumpers feel what they touch."""
        truth = self.body.ground_truth()
        self.publish_truth(truth, self.time_of(truth))
        self.checkpoint(state_of(self.body.world_state()))
        self.bumper.arena = self.world.with_obstacles(self.drive.obstacles)
        self.bumper.place(truth.pose, truth.stamp_s)
        self.press(self.bumper.read().pressed)
        self.status = f"{self.line_status}, {self.drive.collisions} collisions"

    def time_of(self, truth: DriveState) -> Time:
        """Return when, by the run's time, the robot was in a state."""
        return Time.from_nanoseconds(round(self.run_time_s(truth.stamp_s) * 1e9))

    def teardown(self) -> None:
        """Pull the base out; write collisions and distance from the start to `base.json`."""
        self.pull_out()
        self.write_results()


class EmulatedCreateBase(EmulatedBase):
    """An iRobot Create 2 that drives through an arena: see `EmulatedBase`."""

    def shape(self) -> DifferentialDrive:
        """Return a Create's geometry: its driver knows it."""
        return CREATE_2

    def create_device(self, body: SimulatedBody) -> EmulatedCreate:
        """Return the controller."""
        self.create = EmulatedCreate(body=body)
        return self.create

    def press(self, parts: tuple[str, ...]) -> None:
        """Press the two bumpers at the front."""
        self.create.press(sum(bit for bit, part in ((1, "front_right"), (2, "front_left")) if part in parts))


class EmulatedPioneerBase(EmulatedBase):
    """A base with a Pioneer's controller and the stock robot's body: see `EmulatedBase`.

    The controller limits accelerations, as its host tells it; the body's own limits are those of its grip.
    """

    bit_rate: int = setting(BIT_RATES[0], "the controller's parameter HostBaud, bit/s")
    watchdog_s: float = setting(
        2.0, "the controller stops when the host is silent for this time", minimum=0.05, maximum=60.0
    )

    def shape(self) -> DifferentialDrive:
        """Return the stock robot's geometry: a Pioneer's controller tells poses, not turns of its wheels."""
        stock = DifferentialDrive()
        return replace(
            stock,
            max_linear_m_per_s2=stock.max_linear_m_per_s2 * stock.emergency_braking,
            max_angular_rad_per_s2=stock.max_angular_rad_per_s2 * stock.emergency_braking,
            emergency_braking=1.0,
        )

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Refuse a bit rate that the controller does not know."""
        if settings["bit_rate"] not in BIT_RATES:
            raise SettingError(f"must be one of {', '.join(map(str, BIT_RATES))}", "bit_rate")

    def create_device(self, body: SimulatedBody) -> EmulatedPioneer:
        """Return the controller."""
        base = PioneerState(watchdog_s=self.watchdog_s, bit_rate=self.bit_rate)
        self.pioneer = EmulatedPioneer(base=base, body=body)
        return self.pioneer

    def press(self, parts: tuple[str, ...]) -> None:
        """Press the bumpers at the front and at the rear."""
        front, rear = (int(any(part in parts for part in side)) for side in (FRONT, REAR))
        self.pioneer.base.bumpers = (front, rear)


class EmulatedHokuyoLaser(SimulatedDevice, EmulatedDeviceModule):
    """A Hokuyo UTM-30LX that measures an arena from where the simulated robot is.

    Its sweeps show the arena at the time of their stamp, in the frame of the robot's centre.
    """

    seed: int = setting(0, "random seed of the noise")
    noise_m: float = setting(0.01, "standard deviation of a range", minimum=0.0)
    range_max_m: float = setting(10.0, "longest range", minimum=0.1, maximum=60.0)

    def setup(self) -> None:
        """Plug the laser in; it sees nothing until the emulated base has published its pose."""
        angles = UTM_30LX.angles_rad()
        geometry = LaserGeometry(
            angle_min_rad=float(angles[0]),
            angle_increment_rad=2 * math.pi / UTM_30LX.steps_per_turn,
            beams=len(angles),
            range_min_m=UTM_30LX.least_mm / 1000,
            range_max_m=self.range_max_m,
        )
        self.truths: tuple[DriveState, ...] = ()
        self.world = SharedWorld(self, self.on_truth)
        self.laser = SimulatedLaser(self.world.arena, geometry, noise_m=self.noise_m, seed=self.seed)
        self.hokuyo = EmulatedHokuyo(UTM_30LX, self.measure, is_known=self.knows)
        self.plug_in(self.hokuyo)

    def on_truth(self, truth: DriveState) -> None:
        """Remember where the robot was, and show how many sweeps were sent."""
        # The line's thread may be reading the old ones.
        self.truths = (*self.truths[1 - KEPT_TRUTHS :], truth)
        self.status = f"{self.line_status}, {self.hokuyo.sweeps} sweeps"

    def knows(self, measured_s: float) -> bool:
        """Return whether it is known where the robot was at a monotonic time; the line's thread calls it.

        Guesses about a robot that has begun to brake meanwhile would be wrong by degrees.
        """
        truths, late_s = self.truths, self.monotonic_s() - measured_s
        is_late = late_s > MAX_TRUTH_WAIT_S
        return not truths or is_late or truths[-1].stamp_s >= self.run_time_s(measured_s)

    def measure(self, measured_s: float) -> NDArray[np.float64]:
        """Return the ranges from where the robot was at a monotonic time; the line's thread calls it."""
        truths = self.truths
        if not truths:
            return np.full(self.laser.geometry.beams, np.inf)
        stamp_s = self.run_time_s(measured_s)
        self.laser.arena = self.world.arena
        self.laser.place(pose_at(truths, stamp_s), stamp_s)
        return self.laser.scan().ranges_m.astype(np.float64)

    def teardown(self) -> None:
        """Pull the laser out."""
        self.pull_out()


def pose_at(states: Sequence[DriveState], stamp_s: float) -> Pose:
    """Return where a robot was at a time, from states in order of their stamps.

    Between two states it is interpolated; after the last, the robot has driven on at its last speeds.
    """
    after = bisect_right(states, stamp_s, key=lambda state: state.stamp_s)
    if after == 0:
        return states[0].pose
    before = states[after - 1]
    since_s = stamp_s - before.stamp_s
    if after == len(states):
        way_m, turn_rad = before.linear_m_per_s * since_s, before.angular_rad_per_s * since_s
        return before.pose.after_arc(way_m, turn_rad)
    later = states[after]
    share = since_s / (later.stamp_s - before.stamp_s)
    return Pose(
        before.pose.x_m + share * (later.pose.x_m - before.pose.x_m),
        before.pose.y_m + share * (later.pose.y_m - before.pose.y_m),
        wrapped(before.pose.heading_rad + share * wrapped(later.pose.heading_rad - before.pose.heading_rad)),
    )
