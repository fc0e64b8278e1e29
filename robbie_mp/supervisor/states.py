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
    """It ended, and its restarts are used up or it has none. It may be tried again slowly, or be waited for
    if its process was killed and cannot end."""
    STOPPED = "STOPPED"
    """It ended as it was meant to, or because the run stops."""

    @property
    def has_process(self) -> bool:
        """Whether a child in this state has a process."""
        return self in (ChildState.STARTING, ChildState.RUNNING)

    @property
    def is_final(self) -> bool:
        """Whether others go on without it; `robbie module start` starts such a child at once."""
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
    """Set with BACKOFF, and with FAILED if it is tried again."""
    exit_status: ExitStatus | None = None
    """Set when a process ended."""
    last_lines: tuple[str, ...] = ()
    """The end of its output, after a failure."""
