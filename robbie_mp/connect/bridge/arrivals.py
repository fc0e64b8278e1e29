"""Hands messages that another system has sent to the robot, as themselves or as what they become."""

import logging
import math
from collections.abc import Iterable
from typing import Any, cast

from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.transport.records import MessageHandling
from robbie_mp.connect.bridge.driving import drive_command
from robbie_mp.connect.bridge.mapping import Incoming
from robbie_mp.connect.bridge.orders import RELEASE_WITHIN_S
from robbie_mp.messages import (
    ControlState,
    DriveCommand,
    EmergencyStop,
    Message,
    NavigateTo,
    NavigationResult,
    PoseStamped,
    PoseWithCovarianceStamped,
    Time,
    Twist,
    TwistStamped,
)
from robbie_mp.module.calls.errors import TooManyCalls
from robbie_mp.module.module import Module

CONTROL_TOPIC = "control"
"""On which the base says who controls the robot."""
MODES = {ControlState.HOLD: "HOLD", ControlState.MANUAL: "MANUAL"}
"""Those in which the robot does not drive by itself."""
IN_A_ROW = 20
"""After this number of refused messages, their sender is known to be too far away."""


class AgeLog:
    """Says that a bridge refuses messages because of their age, unless it refuses only a few.

    Args:
        log: where to say it.
        cause: what the age may come from, and what helps.
    """

    def __init__(self, log: logging.Logger, cause: str):
        self._log, self._cause = log, cause
        self._in_a_row = 0

    def note(self, incoming: Incoming, age_s: float, valid_for_s: float) -> None:
        """Note a message that may move the robot.

        Args:
            incoming: what the settings say about it.
            age_s: its greatest age, s.
            valid_for_s: how long a velocity is followed, s.
        """
        is_old = age_s > (valid_for_s if incoming.drives else RELEASE_WITHIN_S)
        self._in_a_row = self._in_a_row + 1 if is_old else 0
        if self._in_a_row == IN_A_ROW:
            age = f"may be {age_s:.1f} s old" if math.isfinite(age_s) else "are of unknown age"
            self._log.warning("messages on %s are refused: they %s; %s", incoming.name, age, self._cause)


class GoalGate:
    """Refuses goals that come while the robot may not drive by itself.

    Otherwise they would wait without a word, and the operator who later orders the robot to go on may not
    know of them. A goal that was accepted before that waits.

    Args:
        module: the bridge, in its `setup()`.
        incoming: what its settings say comes in.
    """

    def __init__(self, module: Module, incoming: Iterable[Incoming]):
        self._log = module.log
        self._control = ControlState()
        self.refused = 0
        if any(one.becomes is NavigateTo for one in incoming):
            newest = MessageHandling.KEEP_ONLY_NEWEST
            module.subscribe(ControlState, self._on_control, newest, topic=CONTROL_TOPIC, optional=True)

    def _on_control(self, control: ControlState) -> None:
        self._control = control

    def refuses(self, incoming: Incoming) -> str:
        """Return why a message is refused, and tell it; "" if it is not."""
        mode = MODES.get(self._control.mode, "")
        if incoming.becomes is not NavigateTo or not mode:
            return ""
        reason = f": {one_line(self._control.reason)}" if self._control.reason else ""
        problem = f"the robot is in {mode}{reason}; order it to go on, and send the goal again"
        self.refused += 1
        self._log.warning("a goal on %s is refused: %s", incoming.name, problem)
        return problem


def hand_over(
    module: Module,
    incoming: Incoming,
    message_type: type[Message],
    data: bytes | memoryview,
    valid_for_s: float,
    waited_s: float,
) -> bool:
    """Publish a message that came from another system, or what it becomes, in the name of a module.

    Args:
        module: the bridge; not in its `setup()`.
        incoming: what the settings say about it.
        message_type: the class of the type on the other side.
        data: the message, encoded; it has been checked that it is well formed.
        valid_for_s: how long a velocity is followed, s.
        waited_s: its greatest age, as far as that is known; otherwise, how long it has waited since it
            arrived on this machine, s.

    Returns:
        Whether it was handed over. It is not if the robot has no room for it, or if a velocity, a goal or the
        release of an emergency stop is too old.

    Raises:
        MessageTooLarge: the message does not fit into the module's memory.
    """
    if waited_s > RELEASE_WITHIN_S and _lets_move(incoming, message_type, data):
        return False
    topic, is_latched = incoming.topic, incoming.quality.is_latched
    if incoming.becomes is None:
        return module.publish_encoded(
            message_type.type_name, message_type.version, data, topic=topic, latched=is_latched
        )
    message: Any = message_type.decode(data)
    if incoming.becomes is DriveCommand:
        stamp = Time.from_nanoseconds(module.clock.now_ns())
        command = drive_command(cast("Twist | TwistStamped", message), stamp, valid_for_s, waited_s)
        return command is not None and module.publish(command, topic=topic)
    pose = message.pose.pose if isinstance(message, PoseWithCovarianceStamped) else message.pose
    stamped = PoseStamped(header=message.header, pose=pose)
    if incoming.becomes is PoseStamped:
        return module.publish(stamped, topic=topic, latched=is_latched)
    return _send_goal(module, stamped, topic)


def _lets_move(incoming: Incoming, message_type: type[Message], data: bytes | memoryview) -> bool:
    """Whether a message is a goal, or releases the emergency stop."""
    if message_type.type_name == EmergencyStop.type_name:
        return not cast("EmergencyStop", message_type.decode(data)).engaged
    return incoming.becomes is NavigateTo


def _send_goal(module: Module, pose: PoseStamped, topic: str) -> bool:
    def on_result(result: NavigationResult) -> None:
        module.log.info("the goal was reached after %.1f s", result.duration_s)

    try:
        module.send_goal(NavigateTo(pose=pose), on_result, topic=topic)
    except TooManyCalls:
        return False
    return True
