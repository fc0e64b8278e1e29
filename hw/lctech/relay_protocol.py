"""The serial protocol of the relay boards LCUS-1 to LCUS-8.

Source: LC Technology, LC USB switch communication protocol, as each board's description prints it: four bytes
for a command, of which the last one is the sum of the others. Boards with several relays also answer a single
byte FF with a line for each relay.
"""

import re
from typing import NamedTuple

from robbie_robots.hw.framing import DamagedFrame, Framing

MAX_RELAYS = 8
COMMAND_START = 0xA0
COMMAND_BYTES = 4
QUESTION = b"\xff"
MAX_ANSWER_BYTES = 16
_LINE = re.compile(rb"CH([1-8]): ?(ON|OFF) *\r?\n")


class RelayAnswer(NamedTuple):
    """What a board tells of one relay.

    Attributes:
        relay: its number, from 1.
        is_closed: whether current flows through its normally open contact.
    """

    relay: int
    is_closed: bool


def switch(relay: int, *, close: bool) -> bytes:
    """Return the command that closes or opens a relay.

    Args:
        relay: its number, from 1 to 8.
        close: whether current flows from then on.

    Raises:
        ValueError: there is no relay of this number.
    """
    if not 1 <= relay <= MAX_RELAYS:
        raise ValueError(f"expected a relay from 1 to {MAX_RELAYS}, not {relay}")
    command = [COMMAND_START, relay, int(close)]
    return bytes([*command, sum(command) & 0xFF])


class RelayFraming(Framing[RelayAnswer]):
    """The lines with which a board answers, such as `CH1: ON`."""

    start = b"CH"
    head_bytes = MAX_ANSWER_BYTES

    def length(self, head: bytes) -> int | None:
        """Return the length up to the line's end."""
        end = head.find(b"\n")
        again = head.find(self.start, 1)
        if again >= 0 and (end < 0 or again < end):
            raise DamagedFrame("another line begins before this one's end")
        if end < 0 and len(head) >= MAX_ANSWER_BYTES:
            raise DamagedFrame(f"no end of line in {MAX_ANSWER_BYTES} characters")
        return end + 1 if end >= 0 else None

    def parse(self, frame: bytes) -> RelayAnswer:
        """Return the answer."""
        found = _LINE.fullmatch(frame)
        if found is None:
            raise DamagedFrame(f"no answer of a relay board: {frame!r}")
        return RelayAnswer(int(found[1]), found[2] == b"ON")
