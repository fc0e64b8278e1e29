"""The base classes of requests and replies: messages whose first field says which call they belong to."""

from functools import cache
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar, cast, get_args

from robbie_mp.messages.errors import DeclarationError
from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import uint64

REQUEST_SUFFIX, RESPONSE_SUFFIX = "_Request", "_Response"
GOAL_SUFFIX, FEEDBACK_SUFFIX, RESULT_SUFFIX = "_Goal", "_Feedback", "_Result"


def number_call(message: Message, call: int) -> None:
    """Set the field `call` of a message that is about to be sent.

    Messages are immutable for everybody else. A copy would take longer than the rest of the call.
    """
    object.__setattr__(message, "call", call)


class Reply(Message, template=True):
    """The answer to a request; see `Request`. Its first field, `call`, is set when it is sent."""

    call: uint64 = DEFAULT


ReplyType = TypeVar("ReplyType", bound=Reply)


class Request(Message, Generic[ReplyType], template=True):
    """A message that a server answers with exactly one reply.

        class FoundPath(Reply, name="my_robot/srv/FindPath_Response"):
            length_m: float64

        class FindPath(Request[FoundPath], name="my_robot/srv/FindPath_Request"):
            x_m: float64
            y_m: float64

    The names are those of ROS: `package/srv/NAME_Request` and `package/srv/NAME_Response`. The first field,
    `call`, is set when the request is sent: it numbers the calls of one process of the client.
    """

    call: uint64 = DEFAULT

    if TYPE_CHECKING:

        def _answered(self) -> ReplyType: ...


Asked_co = TypeVar("Asked_co", covariant=True)
Answered_co = TypeVar("Answered_co", covariant=True)
Fed_co = TypeVar("Fed_co", covariant=True)


class Feedback(Message, template=True):
    """How far the work on a goal is; see `Goal`. Its first field, `call`, is set when it is sent."""

    call: uint64 = DEFAULT


class Result(Message, template=True):
    """The result of a goal that was reached; see `Goal`. Its first field, `call`, is set when it is sent."""

    call: uint64 = DEFAULT


FeedbackType = TypeVar("FeedbackType", bound=Feedback)
ResultType = TypeVar("ResultType", bound=Result)


class Goal(Message, Generic[FeedbackType, ResultType], template=True):
    """A message that asks for long work, which ends with exactly one result or error.

        class Driven(Feedback, name="my_robot/action/DriveTo_Feedback"):
            left_m: float64

        class Arrived(Result, name="my_robot/action/DriveTo_Result"):
            duration_s: float64

        class DriveTo(Goal[Driven, Arrived], name="my_robot/action/DriveTo_Goal"):
            x_m: float64
            y_m: float64

    The names are those of ROS: `package/action/NAME_Goal`, `NAME_Feedback` and `NAME_Result`. The first
    field, `call`, is set when the goal is sent.
    """

    call: uint64 = DEFAULT

    if TYPE_CHECKING:

        def _fed_back(self) -> FeedbackType: ...

        def _resulted(self) -> ResultType: ...


class Action(Protocol[Asked_co, Fed_co, Answered_co]):
    """A class of goals, for type checkers: they infer the types of feedback and result."""

    def __call__(self, *arguments: Any, **fields: Any) -> Asked_co:
        """Create a goal."""

    def _fed_back(self, goal: Any, /) -> Fed_co: ...

    def _resulted(self, goal: Any, /) -> Answered_co: ...


class Service(Protocol[Asked_co, Answered_co]):
    """A class of requests, for type checkers: they infer its handler's argument and result."""

    def __call__(self, *arguments: Any, **fields: Any) -> Asked_co:
        """Create a request."""

    def _answered(self, request: Any, /) -> Answered_co: ...


@cache
def reply_type(request_type: type[Request[ReplyType]]) -> type[ReplyType]:
    """Return the type of the replies to a type of requests.

    Raises:
        DeclarationError: the class does not say; write `class FindPath(Request[FoundPath], …)`. Or the names
            do not end as in ROS, with `_Request` and `_Response`.
    """
    name = request_type.__name__
    bases: tuple[Any, ...] = vars(request_type).get("__orig_bases__", ())
    found = [one for base in bases for one in get_args(base) if isinstance(one, type)]
    if len(found) != 1 or not issubclass(found[0], Reply):
        raise DeclarationError(f"{name}: write class {name}(Request[…]), with the class of its replies")
    wanted = response_name(request_type.type_name)
    if found[0].type_name != wanted:
        raise DeclarationError(
            f"{name} and {found[0].__name__}: their ROS names must be package/srv/{name}_Request and "
            f"package/srv/{name}_Response, not {request_type.type_name} and {found[0].type_name}"
        )
    return cast("type[ReplyType]", found[0])


def response_name(request_name: str) -> str:
    """Return the ROS name of the replies to requests: `a/srv/B_Response` for `a/srv/B_Request`."""
    return f"{request_name.removesuffix(REQUEST_SUFFIX)}{RESPONSE_SUFFIX}"


@cache
def goal_types(
    goal_type: type[Goal[FeedbackType, ResultType]],
) -> tuple[type[FeedbackType], type[ResultType]]:
    """Return the types of feedback and result of a type of goals.

    Raises:
        DeclarationError: the class does not say; write `class DriveTo(Goal[Driven, Arrived], …)`. Or the
            names do not end as in ROS.
    """
    name = goal_type.__name__
    bases: tuple[Any, ...] = vars(goal_type).get("__orig_bases__", ())
    found = [one for base in bases for one in get_args(base) if isinstance(one, type)]
    if len(found) != 2 or not (issubclass(found[0], Feedback) and issubclass(found[1], Result)):
        raise DeclarationError(
            f"{name}: write class {name}(Goal[…, …]), with the classes of feedback and result"
        )
    base = goal_type.type_name.removesuffix(GOAL_SUFFIX)
    wanted = f"{base}{GOAL_SUFFIX}", f"{base}{FEEDBACK_SUFFIX}", f"{base}{RESULT_SUFFIX}"
    names = goal_type.type_name, found[0].type_name, found[1].type_name
    if names != wanted:
        raise DeclarationError(
            f"{name}: its ROS names must be like {', '.join(wanted)}, not {', '.join(names)}"
        )
    return cast("tuple[type[FeedbackType], type[ResultType]]", tuple(found))
