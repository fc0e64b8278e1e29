"""The text protocol of pan-tilt units PTU-46, D46 and D47.

Source: Directed Perception, Pan-Tilt Unit (Model PTU) User's Manual, version 2.12.
"""

import re
from typing import NamedTuple

from strenum import StrEnum

from robbie_robots.hw.framing import DamagedFrame, Framing

ARC_SECONDS_PER_TURN = 360 * 3600
MAX_ANSWER_BYTES = 256
_ANSWER_START = re.compile(rb"[*!]")
_LINE_END = re.compile(rb"[\r\n]")
_TEXT = re.compile(rb"[ -~]*")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?", re.ASCII)


class Axis(StrEnum):
    """A joint, by the letter of its commands."""

    PAN = "P"
    TILT = "T"


class PtuAnswer(NamedTuple):
    """A line from the unit.

    Attributes:
        accepted: whether the unit has obeyed; False: the text tells why not.
        text: the value or the message.
        limit_hit: the joint that has run into its limit. Such a line is no answer to a command.
    """

    accepted: bool
    text: str
    limit_hit: Axis | None = None


def echo_off() -> bytes:
    """Return the command not to repeat commands."""
    return b"ED "


def terse() -> bytes:
    """Return the command to answer with bare numbers."""
    return b"FT "


def immediate() -> bytes:
    """Return the command to begin each motion at once."""
    return b"I "


def halt() -> bytes:
    """Return the command to stop both joints."""
    return b"H "


def ask(axis: Axis, what: str) -> bytes:
    """Return the question for a joint's value: P position, S speed, R resolution, N and X limits."""
    return f"{axis}{what} ".encode("ascii")


def move(axis: Axis, position: int) -> bytes:
    """Return the command to move a joint to a position in steps."""
    return f"{axis}P{position} ".encode("ascii")


def speed(axis: Axis, steps_per_s: int) -> bytes:
    """Return the command that sets a joint's speed."""
    return f"{axis}S{steps_per_s} ".encode("ascii")


class PtuFraming(Framing[PtuAnswer]):
    """The unit's answers, each from `*` or `!` to the line's end; an echo before it is skipped."""

    head_bytes = MAX_ANSWER_BYTES
    start = b""

    def find(self, buffer: bytearray, position: int) -> int:
        """Return the next `*` or `!`."""
        match = _ANSWER_START.search(buffer, position)
        return match.start() if match else -1

    def length(self, head: bytes) -> int | None:
        """Return the length up to the line's end; of a report of a limit, 2."""
        if len(head) > 1 and head[:1] == b"!" and head[1:2] in (b"P", b"T"):
            return 2
        end = _LINE_END.search(head)
        again = _ANSWER_START.search(head, 1)
        if again and (end is None or again.start() < end.start()):
            raise DamagedFrame("another answer begins before the line's end")
        if end is None and len(head) == MAX_ANSWER_BYTES:
            raise DamagedFrame(f"no end of line in {MAX_ANSWER_BYTES} characters")
        return end.end() if end else None

    def parse(self, frame: bytes) -> PtuAnswer:
        """Return the answer."""
        if frame in (b"!P", b"!T"):
            return PtuAnswer(False, "", Axis(frame[1:].decode()))
        text = frame[1:].strip()
        if not _TEXT.fullmatch(text):
            raise DamagedFrame(f"no answer of a pan-tilt unit: {frame!r}")
        return PtuAnswer(frame[:1] == b"*", text.decode("ascii"))


def number(answer: PtuAnswer) -> float:
    """Return the number in an answer, terse or verbose.

    Raises:
        DamagedFrame: there is none.
    """
    found = _NUMBER.findall(answer.text)
    if not answer.accepted or not found:
        raise DamagedFrame(f"no number in {answer.text!r}")
    return float(found[-1] if " is " in answer.text else found[0])
