"""Points in time and spans of time (ROS builtin_interfaces)."""

from typing import Self

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import int32, uint32

NANOSECONDS_PER_SECOND = 1_000_000_000


class Time(Message, name="builtin_interfaces/msg/Time", version=1):
    """A point in time, counted from the clock's epoch."""

    sec: int32 = DEFAULT  # s, may be negative
    nanosec: uint32 = DEFAULT  # ns on top of sec, 0 to 999 999 999

    @property
    def nanoseconds(self) -> int:
        """All of it in nanoseconds."""
        return self.sec * NANOSECONDS_PER_SECOND + self.nanosec

    @classmethod
    def from_nanoseconds(cls, nanoseconds: int) -> Self:
        """Return the time so many nanoseconds after the epoch."""
        sec, nanosec = divmod(nanoseconds, NANOSECONDS_PER_SECOND)
        return cls(sec=sec, nanosec=nanosec)


class Duration(Message, name="builtin_interfaces/msg/Duration", version=1):
    """A span of time."""

    sec: int32 = DEFAULT  # s, may be negative
    nanosec: uint32 = DEFAULT  # ns on top of sec, 0 to 999 999 999

    @property
    def nanoseconds(self) -> int:
        """All of it in nanoseconds."""
        return self.sec * NANOSECONDS_PER_SECOND + self.nanosec

    @property
    def seconds(self) -> float:
        """All of it in seconds."""
        return self.nanoseconds / NANOSECONDS_PER_SECOND

    @classmethod
    def from_nanoseconds(cls, nanoseconds: int) -> Self:
        """Return the span of so many nanoseconds."""
        sec, nanosec = divmod(nanoseconds, NANOSECONDS_PER_SECOND)
        return cls(sec=sec, nanosec=nanosec)

    @classmethod
    def from_seconds(cls, seconds: float) -> Self:
        """Return the span of so many seconds, to the nearest nanosecond."""
        return cls.from_nanoseconds(round(seconds * NANOSECONDS_PER_SECOND))
