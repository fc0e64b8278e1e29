"""An emulated relay board LCUS-1 to LCUS-8.

Source: LC Technology, LC USB switch communication protocol.
"""

from robbie_robots.hw.emulation.device import EmulatedClock, EmulatedDevice

START, QUESTION = 0xA0, 0xFF
COMMAND_BYTES = 4


class EmulatedRelays(EmulatedDevice):
    """A board whose relays are open after power-on.

    Args:
        relays: how many it has; one with a single relay tells nothing.
        clock: see `EmulatedDevice`.

    Attributes:
        closed: whether each relay is closed.
    """

    bit_rate = 9600

    def __init__(self, relays: int = 2, clock: EmulatedClock | None = None) -> None:
        super().__init__(clock)
        self._relays = relays
        self.power_on()

    def power_on(self) -> None:
        """Open all relays."""
        self.closed = [False] * self._relays
        self._received = bytearray()

    def receive(self, data: bytes) -> None:
        """Obey commands whose sum is right, and answer questions; drop everything else."""
        for byte in data:
            if not self._received and byte == QUESTION:
                self._tell()
            elif self._received or byte == START:
                self._received.append(byte)
            if len(self._received) == COMMAND_BYTES:
                self._obey(bytes(self._received))
                self._received.clear()

    def _obey(self, command: bytes) -> None:
        _, relay, is_closed, check = command
        if sum(command[:3]) & 0xFF == check and 1 <= relay <= self._relays and is_closed <= 1:
            self.closed[relay - 1] = bool(is_closed)

    def _tell(self) -> None:
        if self._relays > 1:
            for number, is_closed in enumerate(self.closed, 1):
                self.send(b"CH%d: %s\r\n" % (number, b"ON" if is_closed else b"OFF"))
