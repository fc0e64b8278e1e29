"""Pioneer robots (P3-AT, P3-DX, AmigoBot, PeopleBot) on a serial line, or the maker's simulator over TCP."""

import math
from contextlib import suppress
from dataclasses import dataclass

from typing_extensions import Unpack

from robbie_robots.hw.battery import BatteryReading
from robbie_robots.hw.connected_base import BaseLimits, BaseReading, ConnectedBase, difference, nothing_beyond
from robbie_robots.hw.connection.device import DeviceOptions
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.odometry import OdometryNoise
from robbie_robots.hw.pioneer import p2os
from robbie_robots.hw.pioneer.p2os import PacketId, PioneerCommand

BIT_RATE = 9_600
HEADING_MODULUS = 4_096
# The robot's own watchdog waits 2 s unless it was set otherwise; this leaves room for one of 0.15 s. A pulse
# has six bytes: an eighth of the slowest line.
PULSE_PERIOD_S = 0.05
HANDSHAKE_TIMEOUT_S = 0.5
# A damaged answer is asked for again.
CONFIGURATION_ATTEMPTS = 2
# The robot's period of reports before it has reported it.
REPORT_PERIOD_S = 0.1
# What a stop takes beside watchdog and brakes: the controller's cycles, and the wheels behind its speeds.
STOP_RESERVE_S = 0.05
STANDS_WITHIN_S = 0.4
# A robot that may drive no faster hardly moves: its owner should know why.
CRAWL_M_PER_S = 0.1
# A robot that is still connected to a host that has died sends other packets first.
MAX_OTHER_PACKETS = 20
# A robot cannot move farther between two packets: its controller was restarted, or its origin was set.
MAX_STEP_MM = 1_000


P3AT_LIMITS = BaseLimits(1.2, math.radians(300))


@dataclass(frozen=True)
class PioneerModel:
    """The differences between models, from the makers' parameter files.

    Attributes:
        mm_per_count: of the position.
        position_modulus: the position's counts wrap at this: 32,768 with ARCOS, 4,096 with some P2OS.
        half_track: the controller's factor from the difference of the wheels' speeds, mm/s, to rad/s.
        limits: greatest speeds.
        acceleration_m_per_s2: how it speeds up. It brakes as hard as its controller can.
        turn_acceleration_rad_per_s2: likewise, when it turns.
        sonar_max_mm: a sonar that sees nothing tells this or more.
    """

    mm_per_count: float = 0.465
    position_modulus: int = 32_768
    half_track: float = 0.0034
    limits: BaseLimits = P3AT_LIMITS
    acceleration_m_per_s2: float = 1.0
    turn_acceleration_rad_per_s2: float = 5.0
    sonar_max_mm: int = 4_335


P3AT = PioneerModel()
P3AT_SH = PioneerModel(mm_per_count=1.0)
MODELS = {"p3at": P3AT, "p3at-sh": P3AT_SH}


class PioneerBase(ConnectedBase):
    """A Pioneer robot.

    Its own watchdog stops it when the line breaks or the host dies: after 2 s as delivered. Set the robot's
    parameter WatchDog to 150 (ms) with the maker's tool. When this process dies or hangs, the guard stops it
    at once.

    The robot stands `stands_within_s` after its cable was pulled: the driver lets it brake as hard as its
    controller can, reads its watchdog and deceleration, and drives no faster than it can brake from in the
    time that the watchdog leaves. If that is none, or the robot does not tell it, it limits nothing, and its
    problems say why the robot would drive on.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`; the maker's simulator is at "socket://HOST:8101".
        bit_rate: bit/s.
        model: None: the one that the robot names, or a P3-AT.
        stands_within_s: how long after the loss of its line the robot may move; 0: as long as it takes.
        options: see `DeviceOptions`.
    """

    def __init__(
        self,
        url: str,
        bit_rate: int = BIT_RATE,
        model: PioneerModel | None = None,
        *,
        stands_within_s: float = STANDS_WITHIN_S,
        **options: Unpack[DeviceOptions],
    ) -> None:
        # A robot that is steered by the speeds of its two sides slips when it turns.
        noise = OdometryNoise(distance=0.001, heading=0.02, heading_for_distance=0.001)
        limits = (model or P3AT).limits
        super().__init__(url, bit_rate, limits, noise, period_s=REPORT_PERIOD_S, **options)
        self.name: p2os.RobotName | None = None
        """The robot's name for itself in the handshake."""
        self.model = model or P3AT
        self.configuration: p2os.Configuration | None = None
        """What the robot told of its parameters; None: nothing."""
        self._wanted_model = model
        self._stands_within_s = stands_within_s
        self._stop_problem: tuple[str, ...] = ()
        self._decoder = FrameDecoder(p2os.P2osFraming())
        self._unreadable = 0
        self._last: p2os.ServerInformation | None = None
        self._is_back = False
        self._pulse_s = -math.inf

    def poll(self, wait_s: float = 0.0) -> list[BaseReading]:
        """Return what the robot has reported since the last call; keep its watchdog content."""
        if self.is_connected and self._monotonic() - self._pulse_s >= PULSE_PERIOD_S:
            self._pulse_s = self._monotonic()
            self.send(p2os.command(PioneerCommand.PULSE))
        return super().poll(min(wait_s, PULSE_PERIOD_S))

    def _greet(self, port: Port) -> None:
        decoder = FrameDecoder(p2os.P2osFraming())
        # The robot may still be connected to a host that has died.
        port.write(p2os.command(PioneerCommand.CLOSE))
        port.drain(quiet_s=0.12, limit_s=0.5)
        for step in (PioneerCommand.PULSE, PioneerCommand.OPEN, PioneerCommand.CLOSE):
            port.write(p2os.command(step))
            answer = self._answer(port, decoder, step)
        try:
            self.name = p2os.robot_name(answer)
        except DamagedFrame as error:
            raise DeviceFault(f"the robot at {self.url} does not tell its name: {error}") from error
        self.model = self._wanted_model or MODELS.get(self.name.model, P3AT)
        for number, argument in (
            (PioneerCommand.OPEN, None),
            (PioneerCommand.PULSE, None),
            (PioneerCommand.SONAR, 1),
            (PioneerCommand.ENABLE, 1),
        ):
            port.write(p2os.command(number, argument))
        self._set_accelerations(port, decoder)

    def _set_accelerations(self, port: Port, decoder: FrameDecoder[p2os.PioneerPacket]) -> None:
        """Let the robot brake as hard as it can, and limit its speed so that it stands in time."""
        self.configuration = told = self._ask_configuration(port, decoder)
        model = self.model
        speed_up = round(1000 * model.acceleration_m_per_s2)
        turn_up = round(math.degrees(model.turn_acceleration_rad_per_s2))
        port.write(p2os.command(PioneerCommand.ACCELERATION, speed_up))
        port.write(p2os.command(PioneerCommand.TURN_ACCELERATION, turn_up))
        if told is not None:
            self._stamps.set_period(told.report_period_s or REPORT_PERIOD_S)
        if told is not None and _tells_brakes(told):
            port.write(p2os.command(PioneerCommand.ACCELERATION, -told.top_acceleration_mm_per_s2))
            port.write(p2os.command(PioneerCommand.TURN_ACCELERATION, -told.top_turn_acceleration_deg_per_s2))
        self._limit_speed(told)

    def _limit_speed(self, told: p2os.Configuration | None) -> None:
        self.limits, self._stop_problem = self.model.limits, ()
        if not self._stands_within_s:
            return
        if told is None:
            self._stop_problem = ("does not tell whether its watchdog stops it",)
            return
        if not _tells_brakes(told):
            self._stop_problem = ("does not tell how hard it brakes",)
            return
        if not told.watchdog_s:
            self._stop_problem = ("its watchdog is off: it drives on when it loses its line",)
            return
        brake_s = self._stands_within_s - STOP_RESERVE_S - told.watchdog_s
        if brake_s <= 0:
            self._stop_problem = (f"brakes only {told.watchdog_s:g} s after the loss of its line",)
            return
        most = told.top_acceleration_mm_per_s2 / 1000, math.radians(told.top_turn_acceleration_deg_per_s2)
        self.limits = BaseLimits(
            min(self.limits.linear_m_per_s, most[0] * brake_s),
            min(self.limits.angular_rad_per_s, most[1] * brake_s),
        )
        if self.limits.linear_m_per_s < CRAWL_M_PER_S:
            speed = f"{self.limits.linear_m_per_s:.2g} m/s"
            self._stop_problem = (f"drives at most {speed}: its watchdog waits {told.watchdog_s:g} s",)

    def _ask_configuration(
        self, port: Port, decoder: FrameDecoder[p2os.PioneerPacket]
    ) -> p2os.Configuration | None:
        """Return the robot's parameters; None: its firmware does not tell them."""
        for _ in range(CONFIGURATION_ATTEMPTS):
            port.write(p2os.command(PioneerCommand.CONFIG))
            with suppress(DeviceSilent, DamagedFrame):
                return p2os.configuration(self._answer(port, decoder, PacketId.CONFIG))
        return None

    def _answer(self, port: Port, decoder: FrameDecoder[p2os.PioneerPacket], step: int) -> p2os.PioneerPacket:
        end_s = self._monotonic() + HANDSHAKE_TIMEOUT_S
        others = 0
        while (left_s := end_s - self._monotonic()) > 0:
            for packet in decoder.feed(port.read(left_s)):
                if packet.number == step:
                    return packet
                others += 1
                if others > MAX_OTHER_PACKETS:
                    raise DeviceFault(f"the robot at {self.url} answers something else to SYNC{step}")
        raise DeviceSilent(f"no robot answers SYNC{step} at {self.url}")

    def _motion(self, linear_m_per_s: float, angular_rad_per_s: float) -> bytes:
        speed = p2os.command(PioneerCommand.SPEED, round(1000 * linear_m_per_s))
        return speed + p2os.command(PioneerCommand.TURN_RATE, round(math.degrees(angular_rad_per_s)))

    def _halt(self) -> bytes:
        return p2os.command(PioneerCommand.STOP)

    def stop_for_emergency(self) -> None:
        """Brake as hard as possible; do not move again before `release`."""
        self.send(p2os.command(PioneerCommand.EMERGENCY_STOP))
        super().stop_for_emergency()

    def _stop(self) -> None:
        super()._stop()
        self.send(p2os.command(PioneerCommand.ENABLE, 0) + p2os.command(PioneerCommand.CLOSE))

    def _reset(self) -> None:
        super()._reset()
        self._decoder.reset()
        self._is_back = True
        self._pulse_s = -math.inf

    def _take(self, data: bytes) -> list[BaseReading]:
        arrived_s, told = self._clock(), []
        for packet in self._decoder.feed(data):
            if packet.number in (PacketId.STANDING, PacketId.MOVING):
                try:
                    told.append((p2os.server_information(packet), p2os.PACKET_BYTES + len(packet.data)))
                except DamagedFrame:
                    self._unreadable += 1
        self.counters.damaged = self._decoder.damaged + self._unreadable
        self.counters.skipped_bytes = self._decoder.skipped_bytes
        return [self._reading(one, self._report_stamp_s(arrived_s, length)) for one, length in told]

    def _reading(self, told: p2os.ServerInformation, stamp_s: float) -> BaseReading:
        # While its line was away the robot drove on, and counted it, unless its controller was restarted.
        is_restarted = self._is_back and not (told.x or told.y or told.heading)
        before, self._last, self._is_back = self._last, told, False
        distance_m, turn_rad = self._motion_since(told if before is None or is_restarted else before, told)
        linear = (told.left_mm_per_s + told.right_mm_per_s) / 2000
        angular = (told.right_mm_per_s - told.left_mm_per_s) / 2 * self.model.half_track
        state = self._moved(stamp_s, distance_m, turn_rad, (linear, angular))
        # Which bit is which bumper differs between models: a contact counts for both sides.
        pressed = (("front_left", "front_right") if told.front_bumpers else ()) + (
            ("back_left", "back_right") if told.rear_bumpers else ()
        )
        return BaseReading(
            state=state,
            covariance=self.odometer.covariance,
            pressed=pressed,
            battery=BatteryReading(state.stamp_s, told.battery_v, math.nan, math.nan, math.nan),
            charging=None if told.charging is None else told.charging > 0,
            problems=self._problems(told),
            sonar_m={
                number: nothing_beyond(distance, self.model.sonar_max_mm) / 1000
                for number, distance in told.sonar_mm.items()
            },
        )

    def _motion_since(
        self, before: p2os.ServerInformation, now: p2os.ServerInformation
    ) -> tuple[float, float]:
        """Return distance, m, and turn, rad, from one packet to the next."""
        model = self.model
        right_mm, left_mm = (
            difference(newer, older, model.position_modulus) * model.mm_per_count
            for newer, older in ((now.x, before.x), (now.y, before.y))
        )
        if math.hypot(right_mm, left_mm) > MAX_STEP_MM:
            return 0.0, 0.0
        counts = difference(now.heading, before.heading, HEADING_MODULUS)
        turn_rad = counts * 2 * math.pi / HEADING_MODULUS
        heading_rad = before.heading * 2 * math.pi / HEADING_MODULUS + turn_rad / 2
        distance_mm = right_mm * math.cos(heading_rad) + left_mm * math.sin(heading_rad)
        return distance_mm / 1000, turn_rad

    def _problems(self, told: p2os.ServerInformation) -> tuple[str, ...]:
        problems = list(self._stop_problem)
        if told.left_stalled:
            problems.append("left wheels stalled")
        if told.right_stalled:
            problems.append("right wheels stalled")
        if not told.motors_enabled:
            problems.append("motors disabled")
        return tuple(problems)


def _tells_brakes(told: p2os.Configuration) -> bool:
    """Return whether a robot's parameters say how hard it can brake; some firmware leaves zeros there."""
    return bool(told.top_acceleration_mm_per_s2 and told.top_turn_acceleration_deg_per_s2)
