"""Points in time and spans of time (ROS builtin_interfaces)."""

from typing_extensions import Self

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.flaws import Flaw, outside
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import int32, uint32

NANOSECONDS_PER_SECOND = 1_000_000_000


class Time(Message, name="builtin_interfaces/msg/Time", version=1):
    """A point in time, counted from the clock's epoch."""

    sec: int32 = DEFAULT  # s, may be negative
    nanosec: uint32 = DEFAULT  # ns on top of sec, 0 to 999 999 999

    def flaw(self) -> Flaw | None:
        """Return whether the nanoseconds are a second or more."""
        return outside(self, 0, NANOSECONDS_PER_SECOND - 1, "nanosec")

    @property
    def nanoseconds(self) -> int:
        """The whole value in nanoseconds."""
        return self.sec * NANOSECONDS_PER_SECOND + self.nanosec

    @classmethod
    def from_nanoseconds(cls, nanoseconds: int) -> Self:
        """Return the time that is a number of nanoseconds after the epoch."""
        sec, nanosec = divmod(nanoseconds, NANOSECONDS_PER_SECOND)
        return cls(sec=sec, nanosec=nanosec)


class Duration(Message, name="builtin_interfaces/msg/Duration", version=1):
    """A span of time."""

    sec: int32 = DEFAULT  # s, may be negative
    nanosec: uint32 = DEFAULT  # ns on top of sec, 0 to 999 999 999

    def flaw(self) -> Flaw | None:
        """Return whether the nanoseconds are a second or more."""
        return outside(self, 0, NANOSECONDS_PER_SECOND - 1, "nanosec")

    @property
    def nanoseconds(self) -> int:
        """The whole value in nanoseconds."""
        return self.sec * NANOSECONDS_PER_SECOND + self.nanosec

    @property
    def seconds(self) -> float:
        """The whole value in seconds."""
        return self.nanoseconds / NANOSECONDS_PER_SECOND

    @classmethod
    def from_nanoseconds(cls, nanoseconds: int) -> Self:
        """Return a span of a number of nanoseconds."""
        sec, nanosec = divmod(nanoseconds, NANOSECONDS_PER_SECOND)
        return cls(sec=sec, nanosec=nanosec)

    @classmethod
    def from_seconds(cls, seconds: float) -> Self:
        """Return a span of a number of seconds, rounded to nanoseconds."""
        return cls.from_nanoseconds(round(seconds * NANOSECONDS_PER_SECOND))
