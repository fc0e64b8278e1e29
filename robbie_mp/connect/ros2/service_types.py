"""The service types of ROS 2 that a bridge offers or calls.

Robbie's requests, replies, goals, feedbacks and results have a field `call` in front, which numbers the calls
of a module. In ROS they have none, and one without any field has a byte.
"""

from typing import Any, Final, NamedTuple

from robbie_mp.connect.ros2.type_hash import FILLER, service_hash
from robbie_mp.messages import Message, as_dict, schema_text
from robbie_mp.messages.message import fields_of
from robbie_mp.messages.schema_parser import message_type_from_schema

CALL: Final = "call"
_CALL_LINE: Final = f"uint64 {CALL}\n"
_SEPARATOR = f"{'=' * 80}\nMSG: "


class ServiceType(NamedTuple):
    """A type of services.

    Attributes:
        name: as `std_srvs/srv/Trigger`.
        request: the class of its requests.
        response: the class of its responses.
        type_hash: the hash of the service, with requests, responses and events.
    """

    name: str
    request: type[Message]
    response: type[Message]
    type_hash: str


def service_type(name: str, definition: str, **nested: str) -> ServiceType:
    """Return a service type.

        >>> service_type("std_srvs/srv/Empty", "---").type_hash
        'RIHS01_5888399dedec5ccc85ea6451949fd2c9f97bfdf963f9a588821639fcd31b5d19'

    Args:
        name: its full name.
        definition: the text of its file: the request's fields, `---`, and the response's.
        nested: the texts of the types in them, which are of the same package.
    """
    package = name.partition("/")[0]
    halves = [half.strip() or f"uint8 {FILLER}" for half in definition.split("---")]

    def build(half: int) -> type[Message]:
        text = f"{halves[half]}\n"
        used: dict[str, None] = {}
        waiting = [text]
        while waiting:
            words = waiting.pop().replace("[", " ").split()
            found = [one for one in nested if one in words and one not in used]
            used.update(dict.fromkeys(found))
            waiting += [nested[one] for one in found]
        text += "".join(f"{_SEPARATOR}{package}/{one}\n{nested[one]}\n" for one in used)
        return message_type_from_schema(f"{name}{('_Request', '_Response')[half]}", text)

    request, response = build(0), build(1)
    return ServiceType(name, request, response, service_hash(name, request, response))


def ros_type(message_type: type[Message], name: str = "") -> type[Message]:
    """Return the type that the robot's requests, goals and the like have in ROS.

    Args:
        message_type: the robot's class, with a field `call`.
        name: its name in ROS; "": the same.
    """
    text = schema_text(message_type).replace(_CALL_LINE, "", 1)
    has_others = len(fields_of(message_type)) > 1
    text = text if has_others else f"uint8 {FILLER}\n{text}"
    return message_type_from_schema(name or message_type.type_name, text)


def fields_without_call(message: Message) -> dict[str, Any]:
    """Return the fields that a message has both in ROS and on the robot, for `from_dict`."""
    return {name: value for name, value in as_dict(message).items() if name not in (CALL, FILLER)}


TRIGGER: Final = service_type("std_srvs/srv/Trigger", "---\nbool success\nstring message")
SET_BOOL: Final = service_type("std_srvs/srv/SetBool", "bool data\n---\nbool success\nstring message")
