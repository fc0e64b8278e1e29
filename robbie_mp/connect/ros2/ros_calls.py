"""Services and actions of ROS 2 that modules of the robot call as they call one another.

The setting `calls` names each: its name in ROS, the robot's type of its requests or goals, and a topic.

    calls:
      /slam/save: "std_srvs/srv/Trigger"
      /arm/left/home: "Home left"
      /navigate_to_pose: "nav2_msgs/action/NavigateToPose"

The setting `actions` has the same form. It names actions of the robot that nodes of ROS send goals to. One
whose type has another name in ROS has that after `as`:

    actions:
      /spin: "KiltedSpin as nav2_msgs/action/Spin"
"""

import re
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.visible_text import one_line
from robbie_mp.connect.bridge.mapping import MAX_ACCEPTED, NAME, MappingError
from robbie_mp.connect.ros2.action_types import ActionType, action_type
from robbie_mp.connect.ros2.padding import unpadded
from robbie_mp.connect.ros2.service_types import ServiceType, fields_without_call, ros_type
from robbie_mp.connect.ros2.side import Side
from robbie_mp.connect.ros2.type_hash import service_hash
from robbie_mp.messages import Message, from_dict
from robbie_mp.messages.calls import (
    FEEDBACK_SUFFIX,
    GOAL_SUFFIX,
    REQUEST_SUFFIX,
    RESULT_SUFFIX,
    response_name,
)
from robbie_mp.messages.descriptions import KnownTypes
from robbie_mp.module.calls.server import LaterReply
from robbie_mp.module.module import Module, calls_of

_Read = TypeVar("_Read")
_AS = re.compile(r" as (\w+/action/\w+)(?= |$)")
"""Names the type that an action has in ROS."""


class RosCall(NamedTuple):
    """A service of ROS that modules call.

    Attributes:
        name: its name in ROS.
        topic: the robot's name of it.
        requests: the robot's class of its requests.
        replies: the robot's class of its replies.
        service: its type in ROS.
    """

    name: str
    topic: str
    requests: type[Message]
    replies: type[Message]
    service: ServiceType


class SharedAction(NamedTuple):
    """An action that the robot and ROS both know.

    Attributes:
        name: its name in ROS.
        topic: the robot's name of it.
        goals: the robot's class of its goals.
        feedbacks: the robot's class of its feedback.
        results: the robot's class of its results.
        action: its type in ROS.
    """

    name: str
    topic: str
    goals: type[Message]
    feedbacks: type[Message]
    results: type[Message]
    action: ActionType


def check_calls(lines: Mapping[str, str], setting: str) -> None:
    """Check the form of a setting `calls` or `actions`, without the types of the run.

    Args:
        lines: the setting.
        setting: its name.

    Raises:
        MappingError: a line is wrong; the text names all of them.
    """
    problems = [
        f"{name!r}: expected a name such as '/slam/save', and a type with or without a topic; got {text!r}"
        for name, text in lines.items()
        if not NAME.fullmatch(name) or len(_AS.sub("", text, count=1).split()) not in (1, 2)
    ]
    if len(lines) > MAX_ACCEPTED:
        problems.append(f"`{setting}` has more than {MAX_ACCEPTED} names")
    if problems:
        raise MappingError("\n".join(problems))


def calls_named(calls: Mapping[str, str], types: KnownTypes) -> list[RosCall | SharedAction]:
    """Read the setting `calls`.

    Args:
        calls: the setting.
        types: the types of the run.

    Raises:
        MappingError: a line is wrong; the text names all of them.
    """
    return _each(calls, "calls", lambda name, kind, topic: _call_or_action(name, kind, topic, types))


def actions_named(actions: Mapping[str, str], types: KnownTypes) -> list[SharedAction]:
    """Read the setting `actions`; arguments and errors as for `calls_named`.

    Args:
        actions: the setting.
        types: the types of the run.
    """
    return _each(actions, "actions", lambda name, kind, topic: _action(name, kind, topic, types))


def _each(lines: Mapping[str, str], setting: str, read: Callable[[str, str, str], _Read]) -> list[_Read]:
    check_calls(lines, setting)
    found: list[_Read] = []
    problems: list[str] = []
    for name, text in lines.items():
        type_name, _, topic = text.strip().partition(" ")
        try:
            found.append(read(name, type_name, topic.strip()))
        except RobbieError as error:
            problems.append(f"{name!r}: {error}")
    if problems:
        raise MappingError("\n".join(problems))
    return found


def _call_or_action(name: str, type_name: str, topic: str, types: KnownTypes) -> RosCall | SharedAction:
    full = types.find_request(type_name)
    if full.endswith(GOAL_SUFFIX):
        return _action(name, type_name, topic, types)
    requests, replies = types.get(full), types.get(response_name(full))
    request, response = ros_type(requests), ros_type(replies)
    short = full.removesuffix(REQUEST_SUFFIX)
    service = ServiceType(short, request, response, service_hash(short, request, response))
    return RosCall(name, topic, requests, replies, service)


def _action(name: str, type_name: str, rest: str, types: KnownTypes) -> SharedAction:
    full = types.find_request(type_name)
    if not full.endswith(GOAL_SUFFIX):
        raise MappingError(f"{type_name} is a service; `services` offers those")
    short = full.removesuffix(GOAL_SUFFIX)
    kinds = types.get(full), types.get(f"{short}{FEEDBACK_SUFFIX}"), types.get(f"{short}{RESULT_SUFFIX}")
    renamed = _AS.match(f" {rest}")
    in_ros, topic = (renamed[1], _AS.sub("", f" {rest}", count=1).strip()) if renamed else (short, rest)
    suffixes = GOAL_SUFFIX, FEEDBACK_SUFFIX, RESULT_SUFFIX
    there = (ros_type(kind, in_ros + suffix) for kind, suffix in zip(kinds, suffixes, strict=True))
    return SharedAction(name, topic, *kinds, action_type(in_ros, *there))


class RosCalls:
    """Passes calls of modules on to ROS, and the responses back.

    Args:
        module: the bridge, in its `setup()`.
        side: the middleware.
        absolute: returns a name in ROS with the namespace.

    Attributes:
        asked: requests that were passed on.
        failed: those that got no response that its type declares.
    """

    def __init__(self, module: Module, side: Side, absolute: Callable[[str], str]):
        self._module, self._side, self._absolute = module, side, absolute
        self._done: deque[tuple[RosCall, LaterReply, bytes | str]] = deque()
        self.asked = self.failed = 0

    def offer(self, call: RosCall) -> None:
        """Let modules call a service of ROS."""
        name = self._absolute(call.name)
        self._side.join(name, call.service)

        def on_request(request: Any, later: LaterReply) -> None:
            self.asked += 1
            data = from_dict(call.service.request, fields_without_call(request)).encode()
            self._side.call(name, data, lambda result: self._put(call, later, result))

        calls_of(self._module).server.serve_later(call.requests, on_request, call.topic)

    def _put(self, call: RosCall, later: LaterReply, result: bytes | str) -> None:
        """Keep a result for the module; in any thread."""
        self._done.append((call, later, result))
        self._module.tick_soon()

    def tick(self) -> None:
        """Reply to modules."""
        while self._done:
            call, later, result = self._done.popleft()
            if isinstance(result, bytes):
                self._reply(call, later, result)
            else:
                self.failed += 1
                later.refuse(result)

    def _reply(self, call: RosCall, later: LaterReply, data: bytes) -> None:
        try:
            response = call.service.response.decode(data)
            unpadded(response, data)
            later.reply(from_dict(call.replies, fields_without_call(response)))
        except RobbieError as error:
            self.failed += 1
            later.refuse(f"the response of {call.name} is wrong: {one_line(str(error))}")
