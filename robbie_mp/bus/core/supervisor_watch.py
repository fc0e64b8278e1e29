"""Notices that the supervisor makes no progress: it was stopped (SIGSTOP), or it hangs in the kernel."""

import contextlib
import os
import signal
from collections.abc import Callable

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.words import Words

LOOK_NS = 500_000_000
CONTINUE_AFTER = 4
"""Looks without progress until the supervisor is continued: 2 s."""
END_AFTER = 20
"""Looks without progress until the core ends: 10 s."""


class SupervisorWatch:
    """Continues a supervisor that was stopped (SIGCONT); says when to end because it does not continue.

    Nobody else watches the supervisor, unless systemd runs it. Looks are counted instead of time: a pause of
    the whole machine counts as one look.

    Args:
        words: the supervisor's outbound segment. It writes there when each turn of its loop began.
        report: logs an error.
    """

    def __init__(self, words: Words, report: Callable[[str], None]):
        self._words = words
        self._report = report
        self._turn_ns = 0
        self._idle_looks = 0
        self.next_look_ns = 0

    def look(self, now_ns: int) -> bool:
        """Look whether the supervisor makes progress; call this when `next_look_ns` has come.

        Args:
            now_ns: monotonic clock.

        Returns:
            Whether it has made none for so long that the robot must not go on.
        """
        self.next_look_ns = now_ns + LOOK_NS
        turn_ns = self._words[layout.OUT_ACTIVITY_SINCE_NS]
        self._idle_looks = 0 if turn_ns != self._turn_ns else self._idle_looks + 1
        self._turn_ns = turn_ns
        if self._idle_looks == CONTINUE_AFTER:
            self._report("the supervisor makes no progress; it is continued (SIGCONT) in case it was stopped")
        if self._idle_looks >= CONTINUE_AFTER:
            with contextlib.suppress(OSError):
                os.kill(os.getppid(), signal.SIGCONT)
        return self._idle_looks >= END_AFTER
