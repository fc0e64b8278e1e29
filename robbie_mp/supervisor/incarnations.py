"""What the process tree asks of the memory side: one incarnation is one start of one child."""

from typing import NamedTuple, Protocol

from robbie_mp.supervisor.states import StateChange
from robbie_mp.trace.crash import LastWords
from robbie_mp.transport.layout import Activity


class Doing(NamedTuple):
    """One thing that a child is doing; two are equal only if it is still the very same thing."""

    activity: Activity
    subscription: int
    """Its own number, in a handler."""
    since_ns: int
    """Begin, on the machine's monotonic clock; of IDLE, which records were ever taken from its ring."""


class Incarnations(Protocol):
    """Makes, watches and reclaims what each incarnation of a child holds in shared memory.

    All calls come from the supervisor's one thread and must not block. For one incarnation they come in
    this order: `open`, `started`, `is_ready` until it is true, `doing`, `died`, `is_reclaimed` until it is
    true. `started` is missing when the command cannot be executed; `died` comes long after FAILED, or never,
    when SIGKILL does not end the process. `is_reclaimed` is asked only before a restart, which may be long
    after FAILED or STOPPED.
    """

    def open(self, name: str, incarnation: int) -> None:
        """Make its shared memory; the child is started right after.

        A RobbieError or OSError counts as a failed start of this child alone; nothing but `state_changed`
        follows for the incarnation then.
        """

    def started(self, name: str, incarnation: int, pid: int) -> None:
        """Note its process."""

    def is_ready(self, name: str, incarnation: int) -> bool:
        """Tell whether it has finished its setup; asked every few ms while STARTING, and at its end."""

    def awaits_time(self, name: str) -> bool:
        """Tell whether it may wait for the run's time, which a module that is being started will set."""

    def doing(self, name: str, incarnation: int) -> Doing | None:
        """Tell what it is doing now; asked every turn of the loop while RUNNING.

        None: nothing, and nothing is there for it to do. IDLE: nothing, though messages wait in its ring.
        """

    def describe(self, name: str, incarnation: int, doing: Doing) -> str:
        """Put what it has been doing for too long into words, as "hung in tick"."""

    def last_words(self, name: str, incarnation: int) -> LastWords:
        """Return what an ended child has left in its memory; asked before `died`, for a crash report."""

    def died(self, name: str, incarnation: int) -> None:
        """Begin to reclaim: its process is reaped and will never touch the memory again."""

    def is_reclaimed(self, name: str, incarnation: int) -> bool:
        """Tell whether a restart may open the next incarnation; asked every few ms in BACKOFF."""

    def wake(self, name: str, incarnation: int) -> None:
        """Wake it if it waits for messages, so that it sees a signal."""

    def wake_all(self) -> None:
        """Wake everyone who waits for messages, attached tools too: the clock that waits go by was set."""

    def state_changed(self, change: StateChange) -> None:
        """Tell everyone of a change; comes before `open` with STARTING, after `died` with an end."""

    def all_started(self) -> None:
        """Let messages flow: every module has been RUNNING or has ended once. Called once at most."""

    def close(self) -> None:
        """Unlink everything: no child is left. Called once, also after an error."""
