"""The states of children and their changes."""

from dataclasses import dataclass

from strenum import StrEnum

from robbie_mp.run.supervisor.process import ExitStatus


class ChildState(StrEnum):
    """STARTING → RUNNING → (BACKOFF → STARTING)… → FAILED or STOPPED."""

    STARTING = "STARTING"
    """Its process runs but has not finished its setup."""
    RUNNING = "RUNNING"
    BACKOFF = "BACKOFF"
    """It ended and waits for its restart."""
    FAILED = "FAILED"
    """It ended, and it has no restarts left. It may still be retried slowly. A killed process that cannot end
    is FAILED too; the supervisor waits for its end."""
    STOPPED = "STOPPED"
    """It ended as intended, or because the run stops."""

    @property
    def has_process(self) -> bool:
        """Whether a child in this state has a process."""
        return self in (ChildState.STARTING, ChildState.RUNNING)

    @property
    def is_final(self) -> bool:
        """Whether other children do not wait for it; `robbie module start` starts such a child at once."""
        return self in (ChildState.FAILED, ChildState.STOPPED)


STATES = tuple(ChildState)
"""The board stores a state as its position in this tuple, counted from 1."""


def state_name(place: int) -> str:
    """Return the name of a state on the board; '-' for a child that was never started."""
    return str(STATES[place - 1]) if 0 < place <= len(STATES) else "-"


@dataclass(frozen=True)
class StateChange:
    """One change of a child's state."""

    name: str
    incarnation: int
    """Counts the starts from 1; 0 if it was never started."""
    old: ChildState | None
    """None before the first start."""
    new: ChildState
    reason: str
    wall_time_s: float
    """Unix time."""
    restart_in_s: float | None = None
    """Set with BACKOFF, and with FAILED if it is retried."""
    exit_status: ExitStatus | None = None
    """Set when a process ended."""
    last_lines: tuple[str, ...] = ()
    """The last lines of its output, after a failure."""
