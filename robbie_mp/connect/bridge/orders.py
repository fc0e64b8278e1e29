"""Orders that other systems may give the robot: calls of its services, and the emergency stop.

A bridge's setting `services` says what is offered: a name on the other side, the robot's service, and the
fields of its request. With one request, the other side triggers it. With two, it sends true or false.

    services:
      /mission/start: "OrderMission {order: 0}"
      /mission/abort: "OrderMission {order: 2} stops"
      /mission/run: "OrderMission {order: 0} or {order: 1}"
      /grip: "CloseGripper left {force_n: 2.0}"

A word before the fields is the topic of the service. The fields are those of `robbie call`. `stops` after
a request marks one that only stops something. Such a request is never too late; nor is the second of two.
"""

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from robbie_mp.attached.views.message_text import message_of_yaml
from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.bridge.mapping import MAX_ACCEPTED, NAME, MappingError
from robbie_mp.messages import (
    CancelNavigation,
    ControlState,
    EmergencyStop,
    Header,
    Message,
    SetControl,
    Time,
    as_dict,
)
from robbie_mp.messages.calls import REQUEST_SUFFIX, response_name
from robbie_mp.messages.descriptions import KnownTypes
from robbie_mp.module.calls.errors import CallError, TooManyCalls
from robbie_mp.module.module import Module, calls_of

_Read = TypeVar("_Read")
Done = Callable[[bool, str], None]
"""Gets whether an order was carried out, and a text to read."""
ORDER = re.compile(
    r"(?P<service>\S+)(?:\s+(?!stops(?:\s|$))(?P<topic>[^\s{]+))?(?:\s+(?P<on>\{.*?\}))?(?P<stops>\s+stops)?"
    r"(?:\s+or\s+(?P<off>\{.*\}))?"
)
CALL_TIMEOUT_S = 5.0
STOP_TOPIC, STATE_TOPIC = "emergency_stop", "emergency_stop_state"
CONFIRM_S = 1.0
"""How long a base has to confirm an emergency stop or its release."""
REPEAT_S = 0.2
"""A stop that no base has confirmed is sent again after this time. A release is not repeated."""
RELEASE_WITHIN_S = 0.5
"""A release, or another order to move, that has waited longer is refused: much may have happened since."""
MAX_STOPS = 64


class OrderService(NamedTuple):
    """A service of the robot that the other side may call.

    Attributes:
        name: the name on the other side.
        on: the request that it sends.
        off: the request that it sends for false; None: there is only one.
        on_stops: whether `on` only stops something; `off` always does.
        replies: the class of the robot's replies.
        topic: the topic of the robot's service.
    """

    name: str
    on: Message
    off: Message | None
    on_stops: bool
    replies: type[Message]
    topic: str


def check_orders(services: Mapping[str, str]) -> None:
    """Check the form of the setting `services`, without the types of the run.

    Raises:
        MappingError: a line is wrong; the text names all of them.
    """
    _each(services, _parts)


def orders_of(services: Mapping[str, str], types: KnownTypes) -> list[OrderService]:
    """Read the setting `services`; see above.

    Args:
        services: the setting.
        types: the types of the run.

    Raises:
        MappingError: a line is wrong; the text names all of them.
    """
    return _each(services, lambda name, text: _order(name, _parts(name, text), types))


def _each(services: Mapping[str, str], read: Callable[[str, str], _Read]) -> list[_Read]:
    found: list[_Read] = []
    problems: list[str] = []
    for name, text in services.items():
        try:
            found.append(read(name, text))
        except RobbieError as error:
            problems.append(f"{name!r}: {error}")
    if len(services) > MAX_ACCEPTED:
        problems.append(f"`services` has more than {MAX_ACCEPTED} names")
    if problems:
        raise MappingError("\n".join(problems))
    return found


def _parts(name: str, text: str) -> re.Match[str]:
    if not NAME.fullmatch(name):
        raise MappingError("this is not a name such as '/mission/start'")
    parts = ORDER.fullmatch(text.strip())
    if parts is None:
        raise MappingError(
            f"expected a service and the fields of its request, as 'OrderMission {{order: 0}}'; got {text!r}"
        )
    return parts


def _order(name: str, parts: re.Match[str], types: KnownTypes) -> OrderService:
    full = types.find_request(parts["service"])
    if not full.endswith(REQUEST_SUFFIX):
        raise MappingError(f"{parts['service']} is an action; only services can be offered")
    asked = types.get(full)
    on = message_of_yaml(asked, parts["on"] or "{}")
    off = message_of_yaml(asked, parts["off"]) if parts["off"] else None
    on_stops = bool(parts["stops"]) or isinstance(on, CancelNavigation)
    on_stops |= isinstance(on, SetControl) and on.mode == ControlState.HOLD
    return OrderService(name, on, off, on_stops, types.get(response_name(full)), parts["topic"] or "")


def too_late(what: str, waited_s: float, limit_s: float = RELEASE_WITHIN_S) -> str:
    """Return why an order to move is refused for its age; '' if it is young enough.

    Args:
        what: the order, such as "the goal".
        waited_s: how long ago it was sent, s; infinite if the clocks differ too much to tell.
        limit_s: the age from which it is too old, s.
    """
    if waited_s <= limit_s:
        return ""
    if math.isinf(waited_s):
        return f"{what} seems to come from the future; synchronise its sender's clock with this machine's"
    return (
        f"{what} was sent {waited_s:.1f} s ago, which is too long; send it again, "
        "and if that does not help, synchronise its sender's clock with this machine's"
    )


def carry_out(module: Module, order: OrderService, is_on: bool, waited_s: float, done: Done) -> None:
    """Call the robot's service in the name of a bridge.

    Args:
        module: the bridge; not in its `setup()`.
        order: what to call.
        is_on: whether the first request is meant.
        waited_s: how long ago the order was sent, s.
        done: called once, now or later.
    """
    request = order.on if is_on or order.off is None else order.off
    stops = request is order.off or order.on_stops
    if (late := too_late("the order", waited_s)) and not stops:
        done(False, late)
        return

    def on_reply(reply: Message) -> None:
        fields = {name: value for name, value in as_dict(reply).items() if name != "call"}
        done(True, json.dumps(fields, default=str) if fields else "")

    def on_error(error: CallError) -> None:
        done(False, str(error))

    # The client sets the call's number in the request, which is sent once, so each call gets its own.
    copy = type(request).decode(request.encode())
    try:
        calls_of(module).client.call(copy, order.replies, on_reply, on_error, CALL_TIMEOUT_S, order.topic)
    except TooManyCalls as error:
        done(False, str(error))


@dataclass
class _Waiting:
    """A stop or release that no base has confirmed."""

    is_stop: bool
    since_ns: int
    done: Done


class StopSwitch:
    """Engages and releases the emergency stop for another system, and tells it what the base says.

    Args:
        module: the bridge, in its `setup()`.
        origin: where the orders come from, in plain words.
        now_ns: the robot's time; the module's clock by default.
    """

    def __init__(self, module: Module, origin: str, now_ns: Callable[[], int] | None = None):
        self._module, self._origin = module, origin
        self._now_ns = now_ns or module.clock.now_ns
        self._waiting: list[_Waiting] = []
        self._sent_ns = 0
        module.advertise(EmergencyStop, topic=STOP_TOPIC)
        module.subscribe(EmergencyStop, self._on_state, topic=STATE_TOPIC, optional=True)

    def engage(self, done: Done) -> None:
        """Stop the robot, until somebody releases the stop."""
        self._order(True, done)

    def release(self, waited_s: float, done: Done) -> None:
        """Let the robot drive again.

        Args:
            waited_s: how long ago the order was sent, s.
            done: called once, now or later.
        """
        if late := too_late("the order to release", waited_s):
            done(False, late)
        else:
            self._order(False, done)

    def tick(self) -> None:
        """Repeat stops that are not confirmed, and give up in the end; call this often."""
        now_ns = self._module.clock.monotonic_ns()
        for one in [one for one in self._waiting if now_ns - one.since_ns >= CONFIRM_S * 1e9]:
            self._waiting.remove(one)
            what = "stop" if one.is_stop else "release"
            one.done(False, f"the {what} was sent, but no base has confirmed it within {CONFIRM_S:g} s")
        if self._waiting and self._waiting[-1].is_stop and now_ns - self._sent_ns >= REPEAT_S * 1e9:
            self._send(True)

    def _order(self, is_stop: bool, done: Done) -> None:
        for one in [one for one in self._waiting if one.is_stop != is_stop]:
            self._waiting.remove(one)
            one.done(False, "the opposite was ordered before a base confirmed it")
        if len(self._waiting) >= MAX_STOPS:
            self._waiting.pop(0).done(False, "too many orders wait")
        self._waiting.append(_Waiting(is_stop, self._module.clock.monotonic_ns(), done))
        self._send(is_stop)

    def _send(self, is_stop: bool) -> None:
        self._sent_ns = self._module.clock.monotonic_ns()
        header = Header(stamp=Time.from_nanoseconds(self._now_ns()))
        message = EmergencyStop(header=header, engaged=is_stop, reason=self._origin)
        self._module.publish(message, topic=STOP_TOPIC)

    def _on_state(self, state: EmergencyStop) -> None:
        published_ns = self._module.envelope.published_ns
        for one in list(self._waiting):
            if one.is_stop == state.engaged and published_ns > one.since_ns:
                self._waiting.remove(one)
                one.done(True, "the robot stands still" if one.is_stop else "the robot may drive")
