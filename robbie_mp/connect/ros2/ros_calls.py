"""Services of ROS 2 that modules of the robot call as they call one another.

The setting `calls` names each: its name in ROS, the robot's type of its requests, and a topic.

    calls:
      /slam/save: "std_srvs/srv/Trigger"
      /arm/left/home: "Home left"

The type in ROS is that of the robot without the field `call`, which numbers the calls of a module.
"""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.visible_text import one_line
from robbie_mp.connect.bridge.mapping import MAX_ACCEPTED, NAME, MappingError
from robbie_mp.connect.ros2.padding import unpadded
from robbie_mp.connect.ros2.service_types import ServiceType
from robbie_mp.connect.ros2.side import Side
from robbie_mp.connect.ros2.type_hash import service_hash
from robbie_mp.messages import Message, MessageError, as_dict, from_dict, schema_text
from robbie_mp.messages.calls import REQUEST_SUFFIX, response_name
from robbie_mp.messages.descriptions import KnownTypes
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.module.calls.server import LaterReply
from robbie_mp.module.module import Module, calls_of

CALL_FIELD = "uint64 call\n"


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


def check_calls(calls: Mapping[str, str]) -> None:
    """Check the form of the setting `calls`, without the types of the run.

    Raises:
        MappingError: a line is wrong; the text names all of them.
    """
    problems = [
        f"{name!r}: expected a name such as '/slam/save', and a type with or without a topic; got {text!r}"
        for name, text in calls.items()
        if not NAME.fullmatch(name) or len(text.split()) not in (1, 2)
    ]
    if len(calls) > MAX_ACCEPTED:
        problems.append(f"`calls` has more than {MAX_ACCEPTED} names")
    if problems:
        raise MappingError("\n".join(problems))


def calls_named(calls: Mapping[str, str], types: KnownTypes) -> list[RosCall]:
    """Read the setting `calls`.

    Args:
        calls: the setting.
        types: the types of the run.

    Raises:
        MappingError: a line is wrong; the text names all of them.
    """
    check_calls(calls)
    found: list[RosCall] = []
    problems: list[str] = []
    for name, text in calls.items():
        type_name, _, topic = text.strip().partition(" ")
        try:
            found.append(_call(name, type_name, topic.strip(), types))
        except RobbieError as error:
            problems.append(f"{name!r}: {error}")
    if problems:
        raise MappingError("\n".join(problems))
    return found


def _call(name: str, type_name: str, topic: str, types: KnownTypes) -> RosCall:
    full = types.find_request(type_name)
    if not full.endswith(REQUEST_SUFFIX):
        raise MappingError(f"{type_name} is an action; only services can be called")
    requests, replies = types.get(full), types.get(response_name(full))
    request, response = _without_call(requests), _without_call(replies)
    short = full.removesuffix(REQUEST_SUFFIX)
    service = ServiceType(short, request, response, service_hash(short, request, response))
    return RosCall(name, topic, requests, replies, service)


def _without_call(message_type: type[Message]) -> type[Message]:
    """Return the type in ROS, which has no number of the call."""
    return message_type_from_schema(
        message_type.type_name, schema_text(message_type).replace(CALL_FIELD, "", 1)
    )


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
            fields = {one: value for one, value in as_dict(request).items() if one != "call"}
            data = from_dict(call.service.request, fields).encode()
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
            reply = from_dict(call.replies, as_dict(response))
        except MessageError as error:
            self.failed += 1
            later.refuse(f"the response of {call.name} is wrong: {one_line(str(error))}")
            return
        later.reply(reply)
