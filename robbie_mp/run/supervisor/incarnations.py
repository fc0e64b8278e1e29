"""The interface between the process tree and shared memory. One incarnation is one start of one child."""

from typing import NamedTuple, Protocol

from robbie_mp.bus.transport.layout import Activity
from robbie_mp.run.supervisor.states import StateChange
from robbie_mp.run.trace.crash import CrashReport, LastWords


class Doing(NamedTuple):
    """One activity of a child. Two values are equal only if the child is still in the same activity."""

    activity: Activity
    subscription: int
    """In a handler: the number of the subscription."""
    since_ns: int
    """When it began, on the monotonic clock; for IDLE, how many records the child has ever taken."""


class Incarnations(Protocol):
    """Creates, watches and reclaims the shared memory of each incarnation of a child.

    All calls come from the supervisor's only thread and must not block. For one incarnation they come in
    this order: `open`, `started`, `is_ready` until it is true, `doing`, `died`, `is_reclaimed` until it is
    true. `started` is not called when the command cannot be executed. If SIGKILL does not end the process,
    `died` comes long after FAILED, or never. `is_reclaimed` is called only before a restart, which may be
    long after FAILED or STOPPED.
    """

    def open(self, name: str, incarnation: int) -> None:
        """Create the shared memory; the child is started immediately afterwards.

        A RobbieError or OSError counts as a failed start of this child alone. Only `state_changed` then
        follows for the incarnation.
        """

    def started(self, name: str, incarnation: int, pid: int) -> None:
        """Record the child's pid."""

    def is_ready(self, name: str, incarnation: int) -> bool:
        """Return whether the setup is finished; asked every few ms while STARTING, and at the end."""

    def has_ended(self, name: str, incarnation: int) -> bool:
        """Return whether a dead child has said that it ends; called before `died`."""

    def awaits_time(self, name: str) -> bool:
        """Return whether the child may be waiting for a module that is starting to set the run's time."""

    def doing(self, name: str, incarnation: int) -> Doing | None:
        """Return the current activity; asked in every iteration of the loop while RUNNING.

        None: idle, and no work waits. IDLE: idle although messages wait in the child's ring.
        """

    def describe(self, name: str, incarnation: int, doing: Doing) -> str:
        """Describe an activity that has taken too long, such as "hung in tick"."""

    def last_words(self, name: str, incarnation: int) -> LastWords:
        """Return what a dead child left in its memory, for the crash report; called before `died`."""

    def keep_evidence(self, report: CrashReport) -> None:
        """Have a capsule made of a crash; called after `last_words` and before `died`."""

    def died(self, name: str, incarnation: int, *, was_ordered: bool = False) -> None:
        """Begin to reclaim. The process has been reaped and will never touch the memory again.

        Args:
            name: the child.
            incarnation: its incarnation.
            was_ordered: whether somebody has ordered its restart, and may have changed what it died over.
        """

    def is_reclaimed(self, name: str, incarnation: int) -> bool:
        """Return whether the next incarnation may be opened; asked every few ms in BACKOFF."""

    def wake(self, name: str, incarnation: int) -> None:
        """Wake a child that waits for messages, so that it handles a signal."""

    def state_changed(self, change: StateChange) -> None:
        """Publish a change. STARTING comes before `open`; the state after an end comes after `died`."""

    def are_subscribed(self) -> bool:
        """Return whether the core has read what all RUNNING modules have subscribed; asked at the start."""

    def all_started(self) -> None:
        """Let messages flow: every module has been RUNNING or has ended. Called at most once."""

    def close(self) -> None:
        """Unlink everything. Called once when no child is left, also after an error."""
