"""iRobot's Create 2 and Roomba 600 on a serial line or USB."""

import math
from collections import deque

from typing_extensions import Unpack

from robbie_mp.base.device_links import sleep
from robbie_robots.hw.battery import BatteryReading
from robbie_robots.hw.connected_base import BaseLimits, BaseReading, ConnectedBase, difference
from robbie_robots.hw.connection.device import DeviceOptions
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.irobot import open_interface as oi
from robbie_robots.hw.odometry import OdometryNoise

BIT_RATE = 115_200
WHEEL_BASE_M = 0.235
M_PER_COUNT = math.pi * 0.072 / 508.8
ENCODER_MODULUS = 1 << 16
MAX_WHEEL_M_PER_S = oi.MAX_SPEED_MM_PER_S / 1000
# A wheel cannot turn farther between two frames: the robot was switched off and on.
MAX_COUNTS_AT_ONCE = 2_000
# Speeds are the mean over these frames, because encoders count whole steps.
FRAMES_OF_SPEED = 8
STREAM_PERIOD_S = 0.015
STREAM = (7, 9, 10, 11, 12, 14, 21, 22, 23, 24, 25, 26, 34, 35, 43, 44)
# Header, length and checksum, and each packet with its number.
FRAME_BYTES = 3 + sum(1 + oi.struct_of(number).size for number in STREAM)
# The robot needs this time after a change of its mode.
MODE_CHANGE_S = 0.02
_CLIFFS = {
    "cliff_left": "cliff on the left",
    "cliff_front_left": "cliff at the front left",
    "cliff_front_right": "cliff at the front right",
    "cliff_right": "cliff on the right",
}
_CHARGES = (oi.Charging.RECONDITIONING, oi.Charging.FULL, oi.Charging.TRICKLE)


class CreateBase(ConnectedBase):
    """A Create 2. In its safe mode it stops by itself at cliffs, wheel drops and the charger.

    The robot has no watchdog: when its cable is pulled out while it drives, it drives on until its own
    sensors stop it. When this process dies or hangs, the guard stops it.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        bit_rate: bit/s; Create 1 and Roomba 400 have 57,600.
        options: see `DeviceOptions`.
    """

    def __init__(
        self,
        url: str,
        bit_rate: int = BIT_RATE,
        **options: Unpack[DeviceOptions],
    ) -> None:
        limits = BaseLimits(MAX_WHEEL_M_PER_S, 2 * MAX_WHEEL_M_PER_S / WHEEL_BASE_M)
        noise = OdometryNoise()
        super().__init__(url, bit_rate, limits, noise, period_s=STREAM_PERIOD_S, **options)
        self._decoder = FrameDecoder(oi.StreamFraming(STREAM))
        self._encoders: tuple[int, int] | None = None
        self._is_back = False
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=FRAMES_OF_SPEED)
        self.mode = oi.CreateMode.OFF
        """The robot's mode in its last frame."""

    def show(self, lamps: oi.Leds, color: int = 0, intensity: int = 255) -> None:
        """Switch the lamps: see `robbie_robots.hw.irobot.open_interface.leds`."""
        self.send(oi.leds(lamps, color, intensity))

    def sing(self, notes: list[tuple[int, int]]) -> None:
        """Play up to 16 notes: see `robbie_robots.hw.irobot.open_interface.song`."""
        self.send(oi.song(0, notes) + oi.play(0))

    def dock(self) -> None:
        """Let the robot look for its dock by itself; the next command takes it over again."""
        self.send(oi.seek_dock())

    def _greet(self, port: Port) -> None:
        port.write(oi.start())
        sleep(MODE_CHANGE_S)
        port.write(oi.pause_stream() + oi.safe())
        sleep(MODE_CHANGE_S)
        port.drain(quiet_s=0.03, limit_s=0.3)
        port.write(oi.stream(STREAM))

    def _motion(self, linear_m_per_s: float, angular_rad_per_s: float) -> bytes:
        turn = angular_rad_per_s * WHEEL_BASE_M / 2
        left, right = linear_m_per_s - turn, linear_m_per_s + turn
        excess = max(1.0, abs(left) / MAX_WHEEL_M_PER_S, abs(right) / MAX_WHEEL_M_PER_S)
        command = oi.drive_direct(round(1000 * left / excess), round(1000 * right / excess))
        # After a cliff, a wheel drop or the charger the robot is passive, until it is told otherwise.
        return (oi.safe() if self.mode is oi.CreateMode.PASSIVE else b"") + command

    def _halt(self) -> bytes:
        return oi.drive_direct(0, 0)

    def _stop(self) -> None:
        super()._stop()
        self.send(oi.pause_stream())

    def _reset(self) -> None:
        super()._reset()
        self._decoder.reset()
        self._is_back = True
        self._recent.clear()
        self.mode = oi.CreateMode.OFF

    def _take(self, data: bytes) -> list[BaseReading]:
        arrived_s, frames = self._clock(), self._decoder.feed(data)
        self.counters.damaged = self._decoder.damaged
        self.counters.skipped_bytes = self._decoder.skipped_bytes
        return [self._reading(values, self._report_stamp_s(arrived_s, FRAME_BYTES)) for values in frames]

    def _reading(self, values: dict[str, int], stamp_s: float) -> BaseReading:
        encoders = values["left_encoder"], values["right_encoder"]
        state = self._moved(stamp_s, *self._motion_since(encoders, stamp_s))
        bumps = oi.Bumps(values["bumps_and_wheel_drops"] & 0xF)
        self.mode = oi.CreateMode(values["mode"] & 3)
        return BaseReading(
            state=state,
            covariance=self.odometer.covariance,
            pressed=tuple(
                part
                for part, bump in (("front_left", oi.Bumps.BUMP_LEFT), ("front_right", oi.Bumps.BUMP_RIGHT))
                if bump in bumps
            ),
            battery=BatteryReading(
                stamp_s=state.stamp_s,
                voltage_v=values["voltage_mv"] / 1e3,
                current_a=-values["current_ma"] / 1e3,
                charge_ah=values["charge_mah"] / 1e3,
                capacity_ah=values["capacity_mah"] / 1e3,
            ),
            charging=values["charging_state"] in _CHARGES,
            problems=self._problems(values, bumps),
            sonar_m={},
        )

    def _motion_since(
        self, encoders: tuple[int, int], stamp_s: float
    ) -> tuple[float, float, tuple[float, float]]:
        """Return distance, turn and speeds since the last frame."""
        # While its line was away the robot drove on, and counted it, unless it was switched off and on.
        is_restarted = self._is_back and not any(encoders)
        before = encoders if self._encoders is None or is_restarted else self._encoders
        self._encoders, self._is_back = encoders, False
        left, right = (
            difference(newer, older, ENCODER_MODULUS) for newer, older in zip(encoders, before, strict=True)
        )
        if max(abs(left), abs(right)) > MAX_COUNTS_AT_ONCE:
            left = right = 0
        distance_m = (left + right) / 2 * M_PER_COUNT
        turn_rad = (right - left) * M_PER_COUNT / WHEEL_BASE_M
        self._recent.append((stamp_s, distance_m, turn_rad))
        passed_s = self._recent[-1][0] - self._recent[0][0]
        if passed_s <= 0:
            return distance_m, turn_rad, self._speeds
        _, *later = self._recent
        speeds = sum(each[1] for each in later) / passed_s, sum(each[2] for each in later) / passed_s
        return distance_m, turn_rad, speeds

    def _problems(self, values: dict[str, int], bumps: oi.Bumps) -> tuple[str, ...]:
        problems = [text for name, text in _CLIFFS.items() if values[name]]
        if oi.Bumps.WHEEL_DROP_LEFT in bumps:
            problems.append("left wheel dropped")
        if oi.Bumps.WHEEL_DROP_RIGHT in bumps:
            problems.append("right wheel dropped")
        if values["overcurrents"]:
            problems.append("too much current in a motor")
        if values["charging_sources"]:
            problems.append("at the charger")
        if self.mode in (oi.CreateMode.OFF, oi.CreateMode.PASSIVE):
            problems.append(f"{self.mode.name.lower()} mode")
        return tuple(problems)
