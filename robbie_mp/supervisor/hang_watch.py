"""Tells when a child has been doing one and the same thing for too long."""

from robbie_mp.supervisor.incarnations import Doing
from robbie_mp.supervisor.run_queue import RunQueueTime
from robbie_mp.transport.layout import Activity

UNWATCHED_SHARE = 0.05
"""Of its deadline a thing may take before the run queue is looked at, so that short ones cost nothing."""


class HangWatch:
    """Looks at what one child is doing, again and again.

    What counts is the time from the first look at a thing to the last one at which it is still the same: so
    neither words that change between two reads nor another clock can make a child that works look hung. Nor
    can a machine that is overloaded: what a child waits for a processor does not count.
    """

    def __init__(self, deadline_s: float, teardown_deadline_s: float):
        """Set the deadlines.

        Args:
            deadline_s: how long anything but the teardown may take; 0: for ever.
            teardown_deadline_s: how long the teardown may take if it is longer; it may write a large map.
        """
        self._deadline_s = deadline_s
        self._teardown_deadline_s = max(deadline_s, teardown_deadline_s)
        self._doing: Doing | None = None
        self._since_s = 0.0
        self._is_queue_watched = False

    def hung_for_s(self, doing: Doing | None, now_s: float, run_queue: RunQueueTime) -> float | None:
        """Return for how long the child has been hung in what it is doing, None if it is not.

        Args:
            doing: what it is doing now; None: nothing, and nothing is there for it to do.
            now_s: a time that never goes back and stands still with everybody else.
            run_queue: tells how long the child waits for a processor; used by nobody else meanwhile.
        """
        if doing is None or doing != self._doing:
            self._doing = doing
            self._since_s = now_s
            self._is_queue_watched = False
            return None
        in_teardown = doing.activity is Activity.TEARDOWN
        deadline_s = self._teardown_deadline_s if in_teardown else self._deadline_s
        passed_s = now_s - self._since_s
        if not self._deadline_s or passed_s < UNWATCHED_SHARE * deadline_s:
            return None
        if not self._is_queue_watched:
            self._is_queue_watched = True
            run_queue.begin(now_s)
        if passed_s < deadline_s or passed_s - run_queue.waited_s(now_s) < deadline_s:
            return None
        return passed_s
