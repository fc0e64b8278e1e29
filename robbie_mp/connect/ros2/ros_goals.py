"""Actions of ROS 2 that modules of the robot send goals to, as they send them to one another."""

import logging
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final
from uuid import uuid4

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.visible_text import one_line
from robbie_mp.connect.bridge.frames import FrameMap
from robbie_mp.connect.ros2.action_types import CANCEL_GOAL, CANCELED, HAS_ENDED, SUCCEEDED, UNKNOWN, part
from robbie_mp.connect.ros2.goal_desk import uuid_fields
from robbie_mp.connect.ros2.padding import unpadded
from robbie_mp.connect.ros2.ros_calls import SharedAction
from robbie_mp.connect.ros2.service_types import fields_without_call
from robbie_mp.connect.ros2.side import RESPONSE_LIMIT_S, RosChannel, Side
from robbie_mp.messages import Message, MessageError, from_dict
from robbie_mp.messages.frames import renamed
from robbie_mp.module.calls.errors import CallRefused
from robbie_mp.module.calls.server import ActiveGoal
from robbie_mp.module.module import Module, calls_of

MAX_GOALS: Final = 64
"""Most goals of an action that have not ended; further ones are refused."""
FOREVER: Final = float("inf")
MAX_REASON: Final = 1000
"""Most characters of an aborted goal's result that its module hears."""
CANCEL_AGAIN_S: Final = 20.0
"""How long the goals of an earlier process are cancelled again if no node serves them."""


@dataclass(eq=False)
class _Goal:
    """A goal of a module of the robot."""

    action: SharedAction
    active: ActiveGoal[Any, Any, Any]
    goal_id: bytes
    is_accepted: bool = False
    cancel_reason: str | None = None


@dataclass
class _Earlier:
    """A goal of an earlier process of the bridge."""

    action: str
    goal_id: bytes
    until_ns: int
    is_asked: bool = False


class RosGoals:
    """Passes goals of modules on to ROS, and what comes of them back.

    Args:
        module: the bridge, in its `setup()`.
        side: the middleware.
        frames: names of frames on both sides.
        log: where cancels that ROS refuses are told.

    Attributes:
        sent: goals that were passed on.
        failed: those that ROS has refused or not reached.
        malformed: feedback that is not what its type declares.
        on_change: called when a goal was sent or has ended.
    """

    def __init__(self, module: Module, side: Side, frames: FrameMap, log: logging.Logger):
        self._module, self._side, self._frames, self._log = module, side, frames, log
        self._events: deque[Callable[[], None]] = deque()
        self._goals: dict[bytes, _Goal] = {}
        self._earlier: list[_Earlier] = []
        self.channels: dict[RosChannel, SharedAction] = {}
        """The topics of feedback."""
        self.sent = self.failed = self.malformed = 0
        self.on_change: Callable[[], None] = lambda: None

    def offer(self, action: SharedAction) -> None:
        """Let modules send goals to an action of ROS.

        Args:
            action: the action, with its absolute name.
        """
        kind, name = action.action, action.name
        for what, service in (
            ("send_goal", kind.send_goal),
            ("cancel_goal", CANCEL_GOAL),
            ("get_result", kind.get_result),
        ):
            self._side.join(part(name, what), service, name)
        channel = kind.feedback_channel(name)
        self.channels[channel] = action
        self._side.listen(channel)
        types = action.feedbacks, action.results
        server = calls_of(self._module).server
        server.serve_goals_of(
            action.goals, types, partial(self._on_goal, action), self._on_cancel, action.topic
        )

    @property
    def memory(self) -> list[dict[str, Any]]:
        """The goals that have not ended, for `end_earlier` of the next process."""
        return [{"action": one.action.name, "goal": one.goal_id} for one in self._goals.values()]

    def end_earlier(self, memory: Iterable[dict[str, Any]]) -> None:
        """Cancel the goals of an earlier process: their modules have lost them."""
        until_ns = self._module.clock.monotonic_ns() + round(CANCEL_AGAIN_S * 1e9)
        names = {one.name for one in self.channels.values()}
        self._earlier = [
            _Earlier(one["action"], one["goal"], until_ns) for one in memory if one["action"] in names
        ]

    def tick(self) -> None:
        """Do what ROS has answered."""
        while self._events:
            self._events.popleft()()
        for one in self._earlier:
            if not one.is_asked:
                one.is_asked = True
                self._cancel(one.action, one.goal_id, partial(self._on_earlier, one))

    def close(self) -> None:
        """Cancel all goals: nobody hears of their ends any more."""
        for goal in self._goals.values():
            self._cancel(goal.action.name, goal.goal_id, lambda _: None)

    # -- from modules ----------------------------------------------------------------------------------

    def _on_goal(self, action: SharedAction, active: ActiveGoal[Any, Any, Any]) -> None:
        if sum(one.action is action for one in self._goals.values()) >= MAX_GOALS:
            raise CallRefused(f"{MAX_GOALS} goals for {action.name} have not ended")
        goal = _Goal(action, active, uuid4().bytes)
        there = renamed(active.goal, self._frames.name_there)
        fields = {"goal_id": uuid_fields(goal.goal_id), "goal": fields_without_call(there)}
        request = from_dict(action.action.send_goal.request, fields)
        self._goals[goal.goal_id] = goal
        self.sent += 1
        self.on_change()
        self._ask(part(action.name, "send_goal"), request, partial(self._on_sent, goal))

    def _on_cancel(self, active: ActiveGoal[Any, Any, Any], reason: str) -> None:
        for goal in self._goals.values():
            if goal.active is active:
                goal.cancel_reason = reason
                if goal.is_accepted:
                    self._cancel(goal.action.name, goal.goal_id, partial(self._on_cancel_answer, goal))

    def _cancel(self, name: str, goal_id: bytes, done: Callable[[bytes | str], None]) -> None:
        request = from_dict(CANCEL_GOAL.request, {"goal_info": {"goal_id": uuid_fields(goal_id)}})
        self._ask(part(name, "cancel_goal"), request, done)

    def _ask(
        self,
        service: str,
        request: Message,
        done: Callable[[bytes | str], None],
        limit_s: float = RESPONSE_LIMIT_S,
    ) -> None:
        """Call a service of ROS; `done` is called in the module's thread."""

        def keep(result: bytes | str) -> None:
            self._events.append(partial(done, result))
            self._module.tick_soon()

        self._side.call(service, request.encode(), keep, limit_s)

    # -- from ROS --------------------------------------------------------------------------------------

    def on_feedback(self, channel: RosChannel, data: bytes) -> None:
        """Hand feedback to the module whose goal it is about; that on other nodes' goals is nothing to us.

        Args:
            channel: one of `channels`.
            data: the message, of which nothing was checked.
        """
        kind = self.channels[channel].action.feedback
        try:
            told: Any = kind.decode(data)
            unpadded(told, data)
            goal = self._goals.get(bytes(told.goal_id.uuid))
            if goal is not None and goal.active.is_active:
                goal.active.feedback(self._here(goal.action.feedbacks, told.feedback))
        except RobbieError as error:
            self.malformed += 1
            self._log.warning("a feedback on %s was dropped: %s", channel.name, one_line(str(error)))

    def _on_sent(self, goal: _Goal, result: bytes | str) -> None:
        answer, problem = _decoded(goal.action.action.send_goal.response, result)
        if answer is None or not answer.accepted:
            if answer is None:  # the node may have accepted it all the same
                self._cancel(goal.action.name, goal.goal_id, lambda _: None)
            self._fail(goal, problem or f"{goal.action.name} has refused the goal", is_refused=True)
            return
        goal.is_accepted = True
        name = goal.action.name
        request = from_dict(goal.action.action.get_result.request, {"goal_id": uuid_fields(goal.goal_id)})
        self._ask(part(name, "get_result"), request, partial(self._on_result, goal), FOREVER)
        if goal.cancel_reason is not None:
            self._cancel(name, goal.goal_id, partial(self._on_cancel_answer, goal))

    def _on_result(self, goal: _Goal, result: bytes | str) -> None:
        answer, problem = _decoded(goal.action.action.get_result.response, result)
        name = goal.action.name
        if answer is None:
            self._fail(goal, problem)
        elif answer.status == SUCCEEDED:
            self._succeed(goal, answer.result)
        elif answer.status == CANCELED:
            self._forget(goal)
            if goal.active.is_active:
                goal.active.cancelled(goal.cancel_reason or f"{name} has cancelled the goal")
        elif answer.status == UNKNOWN:
            self._fail(goal, f"{name} does not know the goal any more")
        else:
            told = str(fields_without_call(answer.result))[:MAX_REASON]
            self._fail(goal, f"{name} has aborted the goal: {one_line(told)}")

    def _succeed(self, goal: _Goal, result: Message) -> None:
        try:
            if goal.active.is_active:
                goal.active.succeed(self._here(goal.action.results, result))
        except RobbieError as error:  # it can be too large for this module's memory, too
            self._fail(goal, f"the result of {goal.action.name} is wrong: {one_line(str(error))}")
            return
        self._forget(goal)

    def _on_cancel_answer(self, goal: _Goal, result: bytes | str) -> None:
        answer, problem = _decoded(CANCEL_GOAL.response, result)
        is_taken = answer is not None and (answer.goals_canceling or answer.return_code == HAS_ENDED)
        if not is_taken:
            why = problem or "its node refuses that"
            self._log.warning("%s does not cancel a goal: %s", goal.action.name, one_line(why))

    def _on_earlier(self, earlier: _Earlier, result: bytes | str) -> None:
        is_done = isinstance(result, bytes) or self._module.clock.monotonic_ns() >= earlier.until_ns
        if is_done and earlier in self._earlier:
            self._earlier.remove(earlier)
        earlier.is_asked = is_done

    def _fail(self, goal: _Goal, reason: str, *, is_refused: bool = False) -> None:
        self.failed += 1
        self._forget(goal)
        if goal.active.is_active:
            (goal.active.refuse if is_refused else goal.active.abort)(reason)

    def _forget(self, goal: _Goal) -> None:
        self._goals.pop(goal.goal_id, None)
        self.on_change()

    def _here(self, message_type: type[Message], message: Message) -> Message:
        """Return a part of a message of ROS as the robot's message."""
        return from_dict(message_type, fields_without_call(renamed(message, self._frames.name_here)))


def _decoded(message_type: type[Message], result: bytes | str) -> tuple[Any, str]:
    """Return a response, or None and what is wrong."""
    if isinstance(result, str):
        return None, result
    try:
        message = message_type.decode(result)
        unpadded(message, result)
    except MessageError as error:
        return None, f"the response is wrong: {one_line(str(error))}"
    return message, ""
