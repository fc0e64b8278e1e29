"""What the supervisor says of its children: their states, and every change of them."""

from dataclasses import dataclass
from enum import StrEnum

from robbie_mp.supervisor.process import ExitStatus


class ChildState(StrEnum):
    """STARTING → RUNNING → (BACKOFF → STARTING)… → FAILED or STOPPED."""

    STARTING = "STARTING"
    """Its process runs; it has not finished its setup."""
    RUNNING = "RUNNING"
    BACKOFF = "BACKOFF"
    """It ended and waits for its restart."""
    FAILED = "FAILED"
    """It ended and is not started again: it may not be, or its restarts are used up."""
    STOPPED = "STOPPED"
    """It ended as it was meant to, or because the run stops."""

    @property
    def has_process(self) -> bool:
        """Whether a child in this state has a process."""
        return self in (ChildState.STARTING, ChildState.RUNNING)

    @property
    def is_final(self) -> bool:
        """Whether no other state follows by itself; `robbie module start` starts such a child again."""
        return self in (ChildState.FAILED, ChildState.STOPPED)


STATES = tuple(ChildState)
"""The board holds a state as its place in this order, counted from 1."""


def state_name(place: int) -> str:
    """Return the name of a state on the board; '-' for who was never started."""
    return str(STATES[place - 1]) if 0 < place <= len(STATES) else "-"


@dataclass(frozen=True)
class StateChange:
    """One step in the life of a child."""

    name: str
    incarnation: int
    """Counts its starts from 1; 0 if it was never started."""
    old: ChildState | None
    """None before the first start."""
    new: ChildState
    reason: str
    wall_time_s: float
    """Unix time."""
    restart_in_s: float | None = None
    """Set with BACKOFF."""
    exit_status: ExitStatus | None = None
    """Set when a process ended."""
    last_lines: tuple[str, ...] = ()
    """The end of its output, after a failure."""
