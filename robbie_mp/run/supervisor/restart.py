"""Decides whether a child that ended is started again, and when."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from robbie_mp.run.profile.model import RestartPolicy, RestartWhen

JITTER_SHARE = 0.25
"""A wait is shortened by a random share up to this, so modules that died together restart apart."""


@dataclass(frozen=True)
class Restart:
    """Start it again."""

    after_s: float


@dataclass(frozen=True)
class GiveUp:
    """It is FAILED."""

    reason: str
    retry_after_s: float | None = None
    """Time of the next try; None: never."""


@dataclass(frozen=True)
class LeaveStopped:
    """It is STOPPED: it ended as intended."""


class RestartBudget:
    """Applies one child's restart policy over the run.

    Each restart uses one of `max_restarts`. It is available again `within_s` after the restart, not after
    the wait before it. The wait doubles up to the cap. When the budget is used up, each further failure
    allows one slow retry, because hardware may be reconnected. Running for `stable_after_s` restores the
    whole budget and the first wait.
    """

    def __init__(self, policy: RestartPolicy, clock: Callable[[], float], jitter: Callable[[], float]):
        """Start with the whole budget.

        Args:
            policy: the policy from the profile.
            clock: monotonic time in s.
            jitter: returns a random number from 0 to 1.
        """
        self._policy = policy
        self._clock = clock
        self._jitter = jitter
        self._restarts_s: deque[float] = deque()
        self._first_wait_s = min(policy.backoff_s, policy.backoff_cap_s)
        self._backoff_s = self._first_wait_s
        self._running_since_s: float | None = None
        self._is_used_up = False

    def running(self) -> None:
        """Record that the child is RUNNING from now on."""
        self._running_since_s = self._clock()

    def reset(self) -> None:
        """Restore the whole budget and the first wait."""
        self._restarts_s.clear()
        self._backoff_s = self._first_wait_s
        self._is_used_up = False

    def ended(self, *, clean: bool) -> Restart | GiveUp | LeaveStopped:
        """Decide what follows the end of the child.

        Args:
            clean: it ended on its own with exit code 0.
        """
        now_s = self._clock()
        self._refill(now_s)
        policy = self._policy
        if policy.policy is RestartWhen.NEVER:
            return LeaveStopped() if clean else GiveUp("its policy is never to restart")
        if clean and policy.policy is RestartWhen.ON_FAILURE:
            return LeaveStopped()
        if self._is_used_up or len(self._restarts_s) >= policy.max_restarts:
            self._is_used_up = True
            reason = f"all {policy.max_restarts} restarts within {policy.within_s:g} s are used up"
            return GiveUp(reason, policy.retry_s * self._shortening() if policy.retry_s else None)
        wait_s = self._backoff_s * self._shortening()
        self._restarts_s.append(now_s + wait_s)
        self._backoff_s = min(2.0 * self._backoff_s, policy.backoff_cap_s)
        return Restart(wait_s)

    def _shortening(self) -> float:
        return 1.0 - JITTER_SHARE * self._jitter()

    def _refill(self, now_s: float) -> None:
        since_s, self._running_since_s = self._running_since_s, None
        if since_s is not None and now_s - since_s >= self._policy.stable_after_s:
            self.reset()
        while self._restarts_s and now_s - self._restarts_s[0] >= self._policy.within_s:
            self._restarts_s.popleft()
