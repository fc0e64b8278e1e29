"""Pan-tilt units PTU-46, D46 and D47 on a serial line."""

import math
from collections import deque
from collections.abc import Sequence

from typing_extensions import Unpack

from robbie_mp.base.device_links import monotonic
from robbie_robots.hw.connection.device import DeviceOptions, PluggableDevice
from robbie_robots.hw.connection.errors import DeviceFault, DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.flir import ptu_protocol as protocol
from robbie_robots.hw.flir.ptu_protocol import Axis, PtuAnswer, PtuFraming
from robbie_robots.hw.framing import DamagedFrame, FrameDecoder
from robbie_robots.hw.pan_tilt import PanTiltLimits, PanTiltState, PanTiltUnit

BIT_RATE = 9_600
RAD_PER_ARC_SECOND = 2 * math.pi / protocol.ARC_SECONDS_PER_TURN
ANSWER_S = 0.5
# A unit that has just got power turns to its limits first, and answers only then.
QUIET_S, MAX_DRAIN_S = 0.05, 1.0
# Questions and commands wait for the answers to those before; a lost answer is given up after this time.
LOST_S = 0.3
# At 9,600 bit/s, two questions and their answers take some 35 ms.
PERIOD_S = 0.05
QUESTIONS = (Axis.PAN, Axis.TILT)


class FlirPanTilt(PluggableDevice[PanTiltState], PanTiltUnit):
    """A unit that turns to a direction and tells where it looks. `poll` returns its directions.

    `poll` also sends the direction of the newest `look`, in turn with questions for the position: a slow line
    would otherwise keep older ones back, and follow them late.

    It holds its direction when the line breaks: it has no watchdog. A motion that has begun goes on to its
    end, which lies within the unit's own limits.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        rate_rad_per_s: speed of both joints.
        bit_rate: bit/s.
        options: see `DeviceOptions`.

    Example:
        with closing(FlirPanTilt("/dev/ttyUSB0")) as unit:
            unit.poll(1.0)
            unit.look(0.5, 0.0)
    """

    def __init__(
        self,
        url: str,
        rate_rad_per_s: float = 1.0,
        bit_rate: int = BIT_RATE,
        **options: Unpack[DeviceOptions],
    ) -> None:
        super().__init__(url, bit_rate, **options)
        self.limits = PanTiltLimits(rate_rad_per_s=rate_rad_per_s)
        """The limits of the unit, as it has reported them."""
        self.refused = 0
        """How many commands the unit has refused."""
        self._rate_rad_per_s = rate_rad_per_s
        self._decoder = FrameDecoder(PtuFraming())
        self._rad_per_step = dict.fromkeys(QUESTIONS, 1.0)
        # Answers that are still to come, in this order; None: of a command.
        self._expected: deque[Axis | None] = deque()
        self._wanted: tuple[float, float] | None = None
        self._asked_s = self._sent_s = -math.inf
        self._steps: dict[Axis, float] = {}
        self._last = PanTiltState(self._clock(), 0.0, 0.0, 0.0, 0.0)

    def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Move towards a direction, with the next `poll`; without a connection nothing happens."""
        wanted = self.limits.within(pan_rad, tilt_rad)
        if self.is_connected:
            self._wanted = wanted

    def read(self) -> PanTiltState:
        """Return the last direction that the unit has reported."""
        return self._last

    def poll(self, wait_s: float = 0.0) -> list[PanTiltState]:
        """Return the directions since the last call, and ask for the next."""
        if self.is_connected:
            now_s = self._monotonic()
            if self._expected and now_s - self._sent_s > LOST_S:
                self._expected.clear()  # an answer was lost on the way
            due_s = self._asked_s + PERIOD_S
            if not self._expected and now_s >= due_s:
                self._asked_s = now_s
                self._exchange(b"".join(protocol.ask(axis, "P") for axis in QUESTIONS), QUESTIONS)
            elif not self._expected and self._wanted is not None:
                self._move(*self._wanted)
            elif not self._expected:
                wait_s = min(wait_s, due_s - now_s)
        return super().poll(wait_s)

    def _start(self, port: Port) -> None:
        """Have the unit answer tersely; ask for its resolution and its limits."""
        # The blank ends half a command of an earlier host.
        port.write(b" ")
        port.drain(QUIET_S, MAX_DRAIN_S)
        port.write(protocol.echo_off() + protocol.terse())
        port.drain(QUIET_S, MAX_DRAIN_S)
        self._answer(port, protocol.immediate())
        bounds = {}
        for axis in QUESTIONS:
            self._rad_per_step[axis] = self._number(port, axis, "R") * RAD_PER_ARC_SECOND
            step = self._rad_per_step[axis]
            if step <= 0:
                raise DeviceFault(f"the unit at {self.url} does not tell how far a step turns it")
            bounds[axis] = (self._number(port, axis, "N") * step, self._number(port, axis, "X") * step)
            if not bounds[axis][0] <= 0 <= bounds[axis][1]:
                raise DeviceFault(f"the unit at {self.url} has limits without straight ahead: reset it")
            self._answer(port, protocol.speed(axis, max(1, round(self._rate_rad_per_s / step))))
        pan_least, pan_most = bounds[Axis.PAN]
        tilt_least, tilt_most = bounds[Axis.TILT]
        self.limits = PanTiltLimits(min(-pan_least, pan_most), tilt_most, -tilt_least, self._rate_rad_per_s)

    def _take(self, data: bytes) -> list[PanTiltState]:
        states = []
        for answer in self._decoder.feed(data):
            if answer.limit_hit is not None or not self._expected:
                continue
            question = self._expected.popleft()
            if question is None:
                self.refused += not answer.accepted
                continue
            try:
                self._steps[question] = protocol.number(answer)
            except DamagedFrame:
                self._expected.clear()
                continue
            if question is Axis.TILT and len(self._steps) == len(QUESTIONS):
                states.append(self._state())
        self.counters.damaged = self._decoder.damaged
        self.counters.skipped_bytes = self._decoder.skipped_bytes
        return states

    def _state(self) -> PanTiltState:
        """Return the direction; the rates are the mean since the last one."""
        pan = self._steps[Axis.PAN] * self._rad_per_step[Axis.PAN]
        tilt = -self._steps[Axis.TILT] * self._rad_per_step[Axis.TILT]
        before, now_s = self._last, self._clock()
        passed_s = now_s - before.stamp_s
        rates = (0.0, 0.0)
        if 0 < passed_s < self.silence_s:
            rates = ((pan - before.pan_rad) / passed_s, (tilt - before.tilt_rad) / passed_s)
        self._last = PanTiltState(now_s, pan, tilt, *rates)
        self._steps.clear()
        return self._last

    def _move(self, pan_rad: float, tilt_rad: float) -> None:
        self._wanted = None
        # The unit counts tilt upwards.
        angles = {Axis.PAN: pan_rad, Axis.TILT: -tilt_rad}
        steps = {axis: round(angle / self._rad_per_step[axis]) for axis, angle in angles.items()}
        self._exchange(b"".join(protocol.move(*each) for each in steps.items()), (None, None))

    def _exchange(self, sent: bytes, expected: Sequence[Axis | None]) -> None:
        self._sent_s = self._monotonic()
        self._expected.extend(expected)
        self.send(sent)

    def _number(self, port: Port, axis: Axis, what: str) -> float:
        answer = self._answer(port, protocol.ask(axis, what))
        try:
            return protocol.number(answer)
        except DamagedFrame as error:
            raise DeviceFault(f"the unit at {self.url} answers {axis}{what} with {answer.text!r}") from error

    def _answer(self, port: Port, command: bytes) -> PtuAnswer:
        """Send a command and return the answer to it."""
        port.write(command)
        end_s = monotonic() + ANSWER_S
        while (left_s := end_s - monotonic()) > 0:
            for answer in self._decoder.feed(port.read(left_s)):
                if answer.limit_hit is not None:
                    continue
                if not answer.accepted:
                    raise DeviceFault(f"the unit at {self.url} refuses {command.decode()}: {answer.text}")
                return answer
        raise DeviceSilent(f"no pan-tilt unit answers {command.decode()}at {self.url}")

    def _reset(self) -> None:
        self._decoder.reset()
        self._expected.clear()
        self._steps.clear()
        self._wanted = None
        self._asked_s = self._sent_s = -math.inf

    def _stop(self) -> None:
        self.send(protocol.halt())
