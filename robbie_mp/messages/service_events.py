"""Types of service events: messages that say who called a service, and what it answered.

rosbag2 describes such a type by the definition of its service. Source: rosidl's service introspection,
https://github.com/ros-infrastructure/rep/pull/360, and rosbag2_cpp's `local_message_definition_source.cpp`.
"""

import re
from typing import Final

from robbie_mp.messages.errors import SchemaError
from robbie_mp.messages.schema import SEPARATOR
from robbie_mp.messages.schema_parser import SEPARATOR_LINE

EVENT_INFO_NAME: Final = "service_msgs/msg/ServiceEventInfo"
EVENT_INFO: Final = """uint8 event_type
builtin_interfaces/Time stamp
char[16] client_gid
int64 sequence_number
"""
EVENT_NAME = re.compile(r"(?P<package>\w+)/srv/(?P<service>\w+)_Event")
SERVICE_LINE = re.compile(r"\s*SRV:\s*\S+\s*\n")
HALVES = re.compile(r"^---\s*$", re.MULTILINE)


def describes_service(text: str) -> bool:
    """Return whether a definition is that of a service, as rosbag2 writes it for its events."""
    return SERVICE_LINE.search(text) is not None


def is_event_type(type_name: str) -> bool:
    """Return whether messages of a type are events of a service."""
    return EVENT_NAME.fullmatch(type_name) is not None


def event_schema(type_name: str, text: str) -> str:
    """Return the ros2msg text of the events of a service.

    Args:
        type_name: as `std_srvs/srv/Trigger_Event`.
        text: the definition of the service as rosbag2 writes it, with the types in it.

    Raises:
        SchemaError: it is no definition of a service.
    """
    name = EVENT_NAME.fullmatch(type_name)
    _, service, *others = SEPARATOR_LINE.split(text) if describes_service(text) else ("", "")
    halves = HALVES.split(SERVICE_LINE.sub("", service))
    if name is None or len(halves) != 2:
        raise SchemaError(f"{type_name}: its schema is no definition of a service: {text[:100]!r}")
    package, short = name["package"], f"{name['package']}/{name['service']}"
    event = f"{EVENT_INFO_NAME} info\n{short}_Request[<=1] request\n{short}_Response[<=1] response\n"
    named = [
        (EVENT_INFO_NAME, EVENT_INFO),
        (f"{package}/{name['service']}_Request", halves[0]),
        (f"{package}/{name['service']}_Response", halves[1]),
    ]
    made = (f"{SEPARATOR}\nMSG: {one}\n{fields.strip()}\n" for one, fields in named)
    return event + "".join(made) + "".join(f"{SEPARATOR}\n{other.strip()}\n" for other in others)
