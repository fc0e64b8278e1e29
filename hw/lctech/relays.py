"""Lights on the relays of a board LCUS-1 to LCUS-8."""

import math
from collections.abc import Sequence

from typing_extensions import Unpack

from robbie_mp.base.device_links import monotonic
from robbie_robots.hw.connection.device import DeviceOptions, PluggableDevice
from robbie_robots.hw.connection.errors import DeviceSilent
from robbie_robots.hw.connection.port import Port
from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.lctech import relay_protocol as protocol
from robbie_robots.hw.lctech.relay_protocol import RelayAnswer, RelayFraming
from robbie_robots.hw.lights import Lights

BIT_RATE = 9_600
ANSWER_S = 0.3
"""A board that can tell its relays' states answers within this time."""
PERIOD_S = 0.25
"""Time between two questions. At 9,600 bit/s the answer of eight relays takes 0.1 s."""


class RelayLights(PluggableDevice[RelayAnswer], Lights):
    """Lights that are switched by relays. `poll` returns what the board tells of them.

    All are switched off when the board is found and when the driver ends, so after a replug they stay dark
    until the next command. The board has no watchdog: it holds its relays when the line breaks.

    A board may tell the states of its relays. Then a relay that is not as it should be, because a command
    was lost, is switched again. Some boards tell nothing, most of them with one relay; their lights count as
    they were switched.

    Args:
        url: the port: see `robbie_robots.hw.connection.port.Port`.
        names: names of the lights, that on relay 1 first.
        options: see `DeviceOptions`.

    Raises:
        ValueError: there are more lights than relays.

    Example:
        with closing(RelayLights("/dev/ttyUSB0", ["headlight"])) as lights:
            lights.poll(1.0)
            lights.shine("headlight", 1.0)
    """

    can_dim = False

    def __init__(
        self,
        url: str,
        names: Sequence[str],
        **options: Unpack[DeviceOptions],
    ) -> None:
        PluggableDevice.__init__(self, url, BIT_RATE, **options)
        Lights.__init__(self, names)
        if len(self.names) > protocol.MAX_RELAYS:
            raise ValueError(f"a board has at most {protocol.MAX_RELAYS} relays, not {len(self.names)}")
        self.tells = False
        """Whether the board tells its relays' states."""
        self.repeated = 0
        """How many commands were sent again because the relay was not as it should be."""
        self._decoder = FrameDecoder(RelayFraming())
        self._goals = [False] * len(self.names)
        self._asked_s = -math.inf

    def shine(self, name: str, brightness: float) -> float:
        """Switch a light on if the brightness is above 0, else off."""
        place = self.check(name, brightness)
        self._goals[place] = brightness > 0.0
        if not self.send(protocol.switch(place + 1, close=self._goals[place])):
            raise DeviceSilent(f"the lights at {self.url} are not connected: {self.reason}")
        return float(self._goals[place])

    def read(self) -> tuple[float, ...] | None:
        """Return the brightness of each light, 0 or 1; None without a connection."""
        return tuple(map(float, self._goals)) if self.is_connected else None

    def poll(self, wait_s: float = 0.0) -> list[RelayAnswer]:
        """Return what the board has reported since the last call, and ask again."""
        now_s = self._monotonic()
        if self.is_connected and self.tells and now_s >= self._asked_s + PERIOD_S:
            self._asked_s = now_s
            self.send(protocol.QUESTION)
        return super().poll(wait_s)

    def _start(self, port: Port) -> None:
        """Switch all lights off, and find out whether the board tells its relays' states."""
        # Three zeros end half a command of an earlier host: no sum is right then.
        port.write(b"\0" * (protocol.COMMAND_BYTES - 1))
        port.write(self._all_off())
        port.write(protocol.QUESTION)
        end_s = monotonic() + ANSWER_S
        while not self.tells and (left_s := end_s - monotonic()) > 0:
            self.tells = bool(self._decoder.feed(port.read(left_s)))

    def _take(self, data: bytes) -> list[RelayAnswer]:
        answers = self._decoder.feed(data)
        for answer in answers:
            if answer.relay <= len(self._goals) and answer.is_closed != self._goals[answer.relay - 1]:
                self.repeated += 1
                self.send(protocol.switch(answer.relay, close=not answer.is_closed))
        self.counters.damaged = self._decoder.damaged
        self.counters.skipped_bytes = self._decoder.skipped_bytes
        return answers

    def _is_alive(self) -> bool:
        """Return True for a board that tells nothing: it is there as long as its port is."""
        return not self.tells

    def _reset(self) -> None:
        self._decoder.reset()
        self._goals = [False] * len(self.names)
        self._asked_s = -math.inf
        self.tells = False

    def _stop(self) -> None:
        self.send(self._all_off())

    def _all_off(self) -> bytes:
        return b"".join(protocol.switch(place, close=False) for place in range(1, len(self.names) + 1))
