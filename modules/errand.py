"""A request or goal that a module wants done: sent, sent again after an accident, and forgotten."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from robbie_mp import (
    CallError,
    CallRefused,
    Goal,
    GoalAborted,
    GoalCancelled,
    Module,
    NoServer,
    Request,
    SentGoal,
)

JUDGEMENTS = (GoalAborted, GoalCancelled, CallRefused, NoServer)
"""Errors by which the other module says that it does not do it; the others are accidents."""
CALL_S = 2.0


class Errand:
    """Has another module do one thing at a time, whatever dies meanwhile.

        self.errand = Errand(self)

        def tick(self) -> None:
            if self.needs_door:
                self.errand.want("door", MoveDoor(door="hall"), self.on_open)
            else:
                self.errand.drop("not wanted any more")

    Args:
        module: the module that wants it.
        repeat_s: time after which it is sent again that has ended, and is still wanted.
        timeout_s: time limit of a request.
        topic: the name of the service.

    Attributes:
        wanted: what is wanted now; None: nothing.
    """

    def __init__(
        self, module: Module, repeat_s: float = 1.0, timeout_s: float = CALL_S, topic: str = ""
    ) -> None:
        self._module = module
        self._repeat_s, self._timeout_s, self._topic = repeat_s, timeout_s, topic
        self.wanted: object = None
        self._goal: SentGoal | None = None
        self._is_open = False
        self._number = 0
        self._sent_s = -math.inf

    def want(
        self,
        what: object,
        asked: Request[Any] | Goal[Any, Any],
        done: Callable[[Any], None],
        failed: Callable[[CallError], None] = lambda _error: None,
        feedback: Callable[[Any], None] | None = None,
    ) -> None:
        """Send a request or goal, unless it is under way or has just ended; a former one is forgotten.

        Args:
            what: names it; another name is another errand, which is sent at once.
            asked: the request or goal.
            done: called with the reply or result.
            failed: called with the error, if it is one of `JUDGEMENTS`.
            feedback: called with each feedback of a goal.
        """
        is_new = what != self.wanted
        if not is_new and (self._is_open or self._module.monotonic_s() - self._sent_s < self._repeat_s):
            return
        self.wanted, self._goal, self._is_open, self._sent_s = what, None, True, self._module.monotonic_s()
        self._number += 1
        on_end = partial(self._on_end, self._number, done, failed)
        if isinstance(asked, Goal):
            on_feedback = partial(self._on_feedback, self._number, feedback) if feedback else None
            self._goal = self._module.send_goal(asked, on_end, on_end, on_feedback, topic=self._topic)
        else:
            self._module.call(asked, on_end, on_end, timeout_s=self._timeout_s, topic=self._topic)

    def drop(self, reason: str) -> None:
        """Want nothing any more, and cancel a goal that is under way."""
        if self._goal is not None and self._is_open and self._goal.is_active:
            self._goal.cancel(reason)
        self.forget()

    def forget(self) -> None:
        """Want nothing any more; how it ends is not reported."""
        self.wanted, self._goal, self._is_open = None, None, False
        self._number += 1

    def _on_feedback(self, number: int, feedback: Callable[[Any], None], told: Any) -> None:
        if number == self._number:
            feedback(told)

    def _on_end(
        self, number: int, done: Callable[[Any], None], failed: Callable[[CallError], None], end: Any
    ) -> None:
        if number != self._number:
            return  # it is not wanted any more
        self._is_open, self._goal = False, None
        if not isinstance(end, CallError):
            done(end)
            return
        self._module.log.warning("%s: %s: %s", self.wanted, type(end).__name__, end)
        if isinstance(end, JUDGEMENTS):
            failed(end)
