"""The types of an action of ROS 2: three services and two topics under its name.

Source: https://design.ros2.org/articles/actions.html, and the definitions in action_msgs.
"""

from typing import Final, NamedTuple

from robbie_mp.connect.bridge.mapping import Quality
from robbie_mp.connect.ros2.service_types import ServiceType
from robbie_mp.connect.ros2.side import RosChannel
from robbie_mp.connect.ros2.type_hash import service_hash, type_hash
from robbie_mp.messages import Message, Time
from robbie_mp.messages.field_types import FieldType, Items
from robbie_mp.messages.message import nested
from robbie_mp.messages.primitives import PRIMITIVES
from robbie_mp.messages.schema_parser import message_type_from_schema, message_type_of

UUID: Final = message_type_from_schema("unique_identifier_msgs/msg/UUID", "uint8[16] uuid")
_ID, _STAMP, _STATUS = nested(UUID), nested(Time), PRIMITIVES["int8"]
GOAL_INFO: Final = message_type_of("action_msgs/msg/GoalInfo", {"goal_id": _ID, "stamp": _STAMP})
GOAL_STATUS: Final = message_type_of(
    "action_msgs/msg/GoalStatus", {"goal_info": nested(GOAL_INFO), "status": _STATUS}
)
STATUSES: Final = message_type_of(
    "action_msgs/msg/GoalStatusArray", {"status_list": Items(nested(GOAL_STATUS))}
)
UNKNOWN, ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(7)
"""The states of a goal, in `GoalStatus`."""
CANCELS, REFUSES_CANCEL, UNKNOWN_GOAL, HAS_ENDED = range(4)
"""The answers to a cancel."""
STATUS_QUALITY: Final = Quality(is_latched=True, depth=1)


class ActionType(NamedTuple):
    """A type of actions.

    Attributes:
        name: as `test_msgs/action/Fibonacci`.
        send_goal: the service that takes goals.
        get_result: the service that answers when a goal has ended.
        feedback: the messages that tell how far the work on a goal is.
    """

    name: str
    send_goal: ServiceType
    get_result: ServiceType
    feedback: type[Message]

    def feedback_channel(self, name: str) -> RosChannel:
        """Return the topic of feedback of the action of a name."""
        kind = self.feedback
        return RosChannel(part(name, "feedback"), kind.type_name, type_hash(kind), Quality())


def action_type(name: str, goal: type[Message], feedback: type[Message], result: type[Message]) -> ActionType:
    """Return an action type.

    Args:
        name: its full name.
        goal: the class of its goals in ROS.
        feedback: that of its feedback.
        result: that of its results.
    """
    send_goal = _service(
        f"{name}_SendGoal",
        {"goal_id": _ID, "goal": nested(goal)},
        {"accepted": PRIMITIVES["bool"], "stamp": _STAMP},
    )
    get_result = _service(
        f"{name}_GetResult", {"goal_id": _ID}, {"status": _STATUS, "result": nested(result)}
    )
    told = message_type_of(f"{name}_FeedbackMessage", {"goal_id": _ID, "feedback": nested(feedback)})
    return ActionType(name, send_goal, get_result, told)


def status_channel(name: str) -> RosChannel:
    """Return the topic with the states of all goals of an action."""
    return RosChannel(part(name, "status"), STATUSES.type_name, type_hash(STATUSES), STATUS_QUALITY)


def part(name: str, what: str) -> str:
    """Return the name of a service or topic of an action, as `/fibonacci/_action/send_goal`."""
    return f"{name}/_action/{what}"


def _service(name: str, request: dict[str, FieldType], response: dict[str, FieldType]) -> ServiceType:
    asked = message_type_of(f"{name}_Request", request)
    answered = message_type_of(f"{name}_Response", response)
    return ServiceType(name, asked, answered, service_hash(name, asked, answered))


CANCEL_GOAL: Final = _service(
    "action_msgs/srv/CancelGoal",
    {"goal_info": nested(GOAL_INFO)},
    {"return_code": _STATUS, "goals_canceling": Items(nested(GOAL_INFO))},
)
