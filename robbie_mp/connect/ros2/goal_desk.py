"""Actions of the robot that nodes of ROS 2 send goals to.

Each goal of ROS is a goal of the bridge to the module that serves it. ROS hears whether it was accepted when
the module has accepted or refused it, and the bridge keeps its state, as the node of an action does in ROS.
"""

import logging
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.visible_text import one_line
from robbie_mp.connect.bridge.frames import FrameMap
from robbie_mp.connect.bridge.orders import too_late
from robbie_mp.connect.ros2.action_types import (
    ABORTED,
    ACCEPTED,
    CANCEL_GOAL,
    CANCELED,
    CANCELING,
    CANCELS,
    EXECUTING,
    HAS_ENDED,
    STATUSES,
    SUCCEEDED,
    UNKNOWN,
    UNKNOWN_GOAL,
    part,
    status_channel,
)
from robbie_mp.connect.ros2.desk import Desk, RosRequest
from robbie_mp.connect.ros2.ros_calls import SharedAction
from robbie_mp.connect.ros2.service_types import fields_without_call
from robbie_mp.connect.ros2.side import Side
from robbie_mp.messages import Message, Time, from_dict
from robbie_mp.messages.frames import renamed
from robbie_mp.messages.message import fields_of
from robbie_mp.module.calls.client import ClientCalls
from robbie_mp.module.calls.errors import CallError, GoalCancelled

MAX_GOALS: Final = 64
"""Most goals of an action that have not ended; further ones are refused and counted."""
MAX_KEPT: Final = 64
"""Most goals of an action that have ended and whose results are kept; the oldest goes first."""
MAX_WAITING: Final = 8
"""Most requests that wait for the result of a goal; the oldest is answered with the goal's state so far."""
GOAL_WITHIN_S: Final = 2.0
"""An older goal is refused. When many are sent at once, some arrive 0.4 s late."""
ACCEPT_WITHIN_S: Final = 5.0
"""After this time, a goal that the module has neither accepted nor refused is refused."""
KEEP_S: Final = 900.0
"""How long the result of a goal is kept."""
REASON: Final = "error_msg"
"""A text in a result of ROS that says why the goal was not reached."""


@dataclass(eq=False)
class _Goal:
    """A goal of a node of ROS."""

    action: SharedAction
    goal_id: bytes
    stamp: Time
    since_ns: int
    """When it came, or has ended, by the machine's monotonic clock."""
    asked: RosRequest | None
    """The request that sent it, until it is answered."""
    number: int = 0
    """The number of the bridge's call."""
    status: int = UNKNOWN
    result: dict[str, Any] = field(default_factory=dict)
    waiting: list[RosRequest] = field(default_factory=list)
    """Requests for its result."""

    @property
    def has_ended(self) -> bool:
        return self.status >= SUCCEEDED

    @property
    def info(self) -> dict[str, Any]:
        """Its name and time of acceptance, as in `GoalInfo`."""
        return {"goal_id": uuid_fields(self.goal_id), "stamp": time_fields(self.stamp)}


class GoalDesk:
    """Serves goals of nodes of ROS.

    Args:
        client: the calls of the bridge.
        side: the middleware.
        desk: serves requests.
        frames: names of frames on both sides.
        log: where refusals and ends are told.
        now_ns: the robot's time.
        bars: returns why nothing may move now; "": it may.

    Attributes:
        accepted: goals that modules have accepted.
        refused: goals that the modules or the bridge have refused.
        on_change: called when a goal was sent to a module or has ended.
    """

    def __init__(
        self,
        client: ClientCalls,
        side: Side,
        desk: Desk,
        frames: FrameMap,
        log: logging.Logger,
        now_ns: Callable[[], int],
        bars: Callable[[], str] = str,
    ):
        self._client, self._side, self._desk = client, side, desk
        self._frames, self._log, self._now_ns, self._bars = frames, log, now_ns, bars
        self._goals: dict[str, dict[bytes, _Goal]] = {}
        self.accepted = self.refused = 0
        self.on_change: Callable[[], None] = lambda: None

    def offer(self, action: SharedAction) -> None:
        """Offer an action of the robot.

        Args:
            action: the action, with its absolute name.
        """
        self._goals[action.name] = {}
        kind, offer = action.action, self._desk.offer
        offer(part(action.name, "send_goal"), kind.send_goal, partial(self._on_goal, action))
        offer(part(action.name, "cancel_goal"), CANCEL_GOAL, partial(self._on_cancel, action))
        offer(part(action.name, "get_result"), kind.get_result, partial(self._on_get_result, action))
        self._side.announce(kind.feedback_channel(action.name))
        self._tell(action)

    @property
    def memory(self) -> list[dict[str, Any]]:
        """The goals that have not ended, for `end_earlier` of the next process."""
        return [
            {
                "action": one.action.name,
                "goal": one.goal_id,
                "stamp_ns": one.stamp.nanoseconds,
                "call": one.number,
            }
            for goals in self._goals.values()
            for one in goals.values()
            if not one.has_ended
        ]

    def end_earlier(self, actions: Iterable[SharedAction], memory: list[dict[str, Any]]) -> None:
        """Cancel the goals of an earlier process: nodes of ROS cannot end them any more.

        Args:
            actions: the actions that are offered.
            memory: what `memory` of that process was.
        """
        offered = {one.name: one for one in actions}
        for one in memory:
            action = offered.get(one["action"])
            if action is None:
                continue
            reason = "the bridge to ROS 2 has died"
            self._client.end_earlier(one["call"], action.goals, action.topic, reason)
            stamp = Time.from_nanoseconds(one["stamp_ns"])
            goal = _Goal(action, one["goal"], stamp, time.monotonic_ns(), None, one["call"])
            self._goals[action.name][goal.goal_id] = goal
            self._end(goal, ABORTED, _explained(action, reason))

    def tick(self) -> None:
        """Give up what takes too long, and forget old results."""
        now_ns = time.monotonic_ns()
        for goals in self._goals.values():
            for goal in list(goals.values()):
                age_s = (now_ns - goal.since_ns) * 1e-9
                if goal.asked is not None and age_s >= ACCEPT_WITHIN_S:
                    self._client.cancel(goal.number, "it was not accepted in time")
                    self._refuse(goal, f"its module has not accepted it within {ACCEPT_WITHIN_S:g} s")
                elif goal.has_ended and age_s >= KEEP_S:
                    del goals[goal.goal_id]

    # -- goals -----------------------------------------------------------------------------------------

    def _on_goal(self, action: SharedAction, asked: RosRequest) -> None:
        goals = self._goals[action.name]
        goal_id = bytes(asked.request.goal_id.uuid)
        stamp = Time.from_nanoseconds(self._now_ns())
        goal = _Goal(action, goal_id, stamp, time.monotonic_ns(), asked)
        if goal_id in goals:
            self._refuse(goal, "its number was used before")
        elif late := too_late("the goal", asked.waited_s, GOAL_WITHIN_S):
            self._refuse(goal, late)
        elif sum(not one.has_ended for one in goals.values()) >= MAX_GOALS:
            self._refuse(goal, f"{MAX_GOALS} goals have not ended")
        elif reason := self._bars():
            self._refuse(goal, reason)
        else:
            goals[goal_id] = goal
            try:
                self._send(goal, asked.request.goal)
            except RobbieError as error:
                self._refuse(goal, str(error))

    def _send(self, goal: _Goal, sent: Message) -> None:
        """Send a goal to the module that serves it."""
        action = goal.action
        here = from_dict(action.goals, fields_without_call(renamed(sent, self._frames.name_here)))
        goal.number = self._client.call(
            here,
            action.results,
            lambda result: self._on_result(goal, result),
            lambda error: self._on_error(goal, error),
            None,
            action.topic,
            action.feedbacks,
            lambda feedback: self._on_feedback(goal, feedback),
            lambda: self._on_accepted(goal),
        )
        self.on_change()

    def _refuse(self, goal: _Goal, reason: str) -> None:
        self.refused += 1
        self._log.warning("a goal for %s was refused: %s", goal.action.name, one_line(reason))
        if self._is_known(goal):
            del self._goals[goal.action.name][goal.goal_id]
            self.on_change()
        for one in goal.waiting:
            one.answer(status=UNKNOWN)
        asked, goal.asked = goal.asked, None
        if asked is not None:
            asked.answer(accepted=False)

    def _is_known(self, goal: _Goal) -> bool:
        """Whether a goal was not given up; what its module tells of it later says nothing any more."""
        return self._goals[goal.action.name].get(goal.goal_id) is goal

    # -- what the module says of a goal ----------------------------------------------------------------

    def _on_accepted(self, goal: _Goal) -> None:
        if not self._is_known(goal) or goal.asked is None:
            return
        self.accepted += 1
        asked, goal.asked = goal.asked, None
        goal.status = CANCELING if goal.status == CANCELING else EXECUTING
        asked.answer(accepted=True, stamp=time_fields(goal.stamp))
        self._tell(goal.action)

    def _on_feedback(self, goal: _Goal, feedback: Message) -> None:
        if not self._is_known(goal):
            return
        fields = fields_without_call(renamed(feedback, self._frames.name_there))
        kind = goal.action.action
        told = from_dict(kind.feedback, {"goal_id": uuid_fields(goal.goal_id), "feedback": fields})
        self._side.send(kind.feedback_channel(goal.action.name), told.encode())

    def _on_result(self, goal: _Goal, result: Message) -> None:
        if self._is_known(goal):
            self._end(goal, SUCCEEDED, fields_without_call(renamed(result, self._frames.name_there)))

    def _on_error(self, goal: _Goal, error: CallError) -> None:
        if not self._is_known(goal):
            return
        if goal.asked is not None:
            self._refuse(goal, str(error))
            return
        self._log.info("a goal for %s was not reached: %s", goal.action.name, one_line(str(error)))
        status = CANCELED if isinstance(error, GoalCancelled) else ABORTED
        self._end(goal, status, _explained(goal.action, str(error)))

    def _end(self, goal: _Goal, status: int, result: dict[str, Any]) -> None:
        goal.status, goal.result, goal.since_ns = status, result, time.monotonic_ns()
        waiting, goal.waiting = goal.waiting, []
        for one in waiting:
            one.answer(status=status, result=result)
        goals = self._goals[goal.action.name]
        kept = sorted((one for one in goals.values() if one.has_ended), key=lambda one: one.since_ns)
        for old in kept[:-MAX_KEPT]:
            del goals[old.goal_id]
        self._tell(goal.action)
        self.on_change()

    # -- what nodes ask about goals --------------------------------------------------------------------

    def _on_cancel(self, action: SharedAction, asked: RosRequest) -> None:
        """Cancel one goal, those that were accepted until a time, or all; that is never too late."""
        info, goals = asked.request.goal_info, self._goals[action.name]
        goal_id, until_ns = bytes(info.goal_id.uuid), info.stamp.nanoseconds
        is_one, are_all = any(goal_id), not any(goal_id) and not until_ns
        chosen = [
            one
            for one in goals.values()
            if not one.has_ended
            and (are_all or one.goal_id == goal_id or (until_ns and one.stamp.nanoseconds <= until_ns))
        ]
        for one in chosen:
            one.status = CANCELING
            self._client.cancel(one.number, "a node of ROS has cancelled it")
        code = CANCELS
        if is_one and not chosen:
            code = HAS_ENDED if goal_id in goals else UNKNOWN_GOAL
        asked.answer(return_code=code, goals_canceling=[one.info for one in chosen])
        if chosen:
            self._tell(action)

    def _on_get_result(self, action: SharedAction, asked: RosRequest) -> None:
        goal = self._goals[action.name].get(bytes(asked.request.goal_id.uuid))
        if goal is None or goal.has_ended:
            asked.answer(status=goal.status if goal else UNKNOWN, result=goal.result if goal else {})
            return
        goal.waiting.append(asked)
        if len(goal.waiting) > MAX_WAITING:
            goal.waiting.pop(0).answer(status=goal.status)

    def _tell(self, action: SharedAction) -> None:
        """Tell ROS the states of all goals of an action."""
        known = [one for one in self._goals[action.name].values() if one.status >= ACCEPTED]
        states = [{"goal_info": one.info, "status": one.status} for one in known]
        told = from_dict(STATUSES, {"status_list": states})
        self._side.send(status_channel(action.name), told.encode())


def uuid_fields(goal_id: bytes) -> dict[str, Any]:
    """Return the number of a goal, as in a message."""
    return {"uuid": np.frombuffer(goal_id, np.uint8)}


def time_fields(stamp: Time) -> dict[str, int]:
    """Return a time, as in a message."""
    return {"sec": stamp.sec, "nanosec": stamp.nanosec}


def _explained(action: SharedAction, reason: str) -> dict[str, Any]:
    """Return the result of a goal that was not reached."""
    names = {one.name for one in fields_of(action.results)}
    return {REASON: one_line(reason)} if REASON in names else {}
