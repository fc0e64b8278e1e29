"""The permission to drive this robot: one operator at a time, and another one only after an explicit request.

The emergency stop is not among what an operator must have control for: everybody may stop the robot.
"""

from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any

from robbie_mp.base.visible_text import one_line
from robbie_mp.connect.link.access import AccessError, read_rules
from robbie_mp.logs.capture.selection import TypeAndTopic
from robbie_mp.messages import ControlState, EmergencyStop, OperatorRequest, OperatorState, Time

FREE_AFTER_NS = 10_000_000_000
"""An operator of whom nothing has been heard for this long no longer has control."""
LET_GO_NS = 500_000_000
"""An operator whose commands are refused has let go when none has come for this time."""
REPEAT_NS = 1_000_000_000
"""While commands are refused, the state is published this often."""
MAX_NAME = 32
MANUAL_TOPIC = "manual"
"""Of drive commands by hand. A program that drives by others holds nothing on."""
STATE_TOPIC = "operator_state"
REQUEST_TOPIC = "operator_request"
ORDERS = {OperatorRequest.GO_ON: ControlState.AUTO, OperatorRequest.HOLD: ControlState.HOLD}
"""Wishes about the robot and not the command: how it is to be controlled."""


def read_commanding(patterns: list[str]) -> list[TypeAndTopic]:
    """Return the pairs of type and topic for which an operator must have control.

    Args:
        patterns: a type, or a type and a topic with a space between.

    Raises:
        AccessError: a pattern cannot be understood, or includes the emergency stop.
    """
    ((_, pairs),) = read_rules({"operator": patterns})
    for text, pair in zip(patterns, pairs, strict=True):
        if fnmatchcase(EmergencyStop.type_name, pair.type):
            raise AccessError(f"{text!r} includes the emergency stop, which is obeyed from everybody")
    return pairs


def driver_text(operator: str) -> str:
    """Return who drives, in plain words.

    Args:
        operator: name of the operator who has control; '' if nobody has.
    """
    return f"{one_line(operator)[:MAX_NAME]} drives" if operator else "nobody drives"


class LinkOperators:
    """Knows who has control of this robot.

    Args:
        robot: the name of this robot; its own page has control under this name.
        before: what the last process knew, from `as_data`.

    Attributes:
        holder: name of the operator who has control; '' if nobody has.
        refused: commands that were refused because another operator has control.
        refused_operator: who sent the newest of them.
        is_news: whether the others do not know yet who has control.
    """

    def __init__(self, robot: str, before: Mapping[str, Any] | None = None):
        known = before or {"holder": "", "since_ns": 0, "refused": 0, "refused_operator": ""}
        self.robot = robot
        self.holder: str = known["holder"]
        self.refused: int = known["refused"]
        self.refused_operator: str = known["refused_operator"]
        self.is_news = True
        self._since_ns: int = known["since_ns"]
        self._refused_ns: dict[str, int] = {}
        """When each operator's last refused command came."""
        self._driven_ns: dict[str, int] = {self.holder: -1} if self.holder else {}
        """When each operator has last driven, of those who have not said that they let go."""
        self._heard_ns = 0
        self._told_ns = 0
        self._told_refused: int = self.refused

    def as_data(self) -> dict[str, Any]:
        """Return what the next process must know."""
        return {
            "holder": self.holder,
            "since_ns": self._since_ns,
            "refused": self.refused,
            "refused_operator": self.refused_operator,
        }

    def obeys(self, operator: str, now_ns: int, utc_ns: int) -> bool:
        """Return whether a command is obeyed. While nobody has control, a command takes it.

        But not of an operator who was refused and holds the control on: that is no order to move now.

        Args:
            operator: the sender.
            now_ns: the module's time.
            utc_ns: the clock's time.
        """
        holds_on = now_ns - self._refused_ns.get(operator, -LET_GO_NS) < LET_GO_NS
        if not self.holder and not holds_on:
            self._give(operator, now_ns, utc_ns)
        if self.holder == operator:
            return True
        self._note_refusal(operator, now_ns)
        return False

    def _note_refusal(self, operator: str, now_ns: int) -> None:
        recent = {one: at_ns for one, at_ns in self._refused_ns.items() if now_ns - at_ns < LET_GO_NS}
        self._refused_ns = {**recent, operator: now_ns}
        self.refused += 1
        self.refused_operator = operator

    def see_drive(self, operator: str, up_ns: int, now_ns: int, utc_ns: int, *, moves: bool) -> None:
        """Take it that an operator drives, before `obeys` is asked, or lets the robot stand.

        One who drove when the link went down, and does so as soon as it is up again, has held the control all
        the time: that is no order to move now.

        Args:
            operator: the sender of the command.
            up_ns: when the link to the operator last came up.
            now_ns: the module's time.
            utc_ns: the clock's time.
            moves: whether the command moves the robot.
        """
        if not moves:
            self._driven_ns.pop(operator, None)
            self._refused_ns.pop(operator, None)
            return
        if self._driven_ns.get(operator, now_ns) < up_ns and now_ns - up_ns < LET_GO_NS:
            if self.holder == operator:
                self._give("", now_ns, utc_ns)
            self._note_refusal(operator, now_ns)
        self._driven_ns[operator] = now_ns

    def request(self, operator: str, request: OperatorRequest, now_ns: int, utc_ns: int) -> None:
        """Follow a request of an operator.

        Args:
            operator: the sender.
            request: the wish, none of `ORDERS`.
            now_ns: the module's time.
            utc_ns: the clock's time.
        """
        is_holder = self.holder == operator
        if request.wish == OperatorRequest.GIVE_UP:
            if is_holder:
                self._give("", now_ns, utc_ns)
        elif not is_holder and (request.wish == OperatorRequest.TAKE_OVER or not self.holder):
            self._give(operator, now_ns, utc_ns)

    def look_after(self, is_heard: bool, now_ns: int, utc_ns: int) -> None:
        """Free the command if its holder has not been heard for long.

        Args:
            is_heard: whether the holder is heard now.
            now_ns: the module's time.
            utc_ns: the clock's time.
        """
        if is_heard or not self.holder or not self._heard_ns:
            self._heard_ns = now_ns
        elif now_ns - self._heard_ns >= FREE_AFTER_NS:
            self._give("", now_ns, utc_ns)

    @property
    def is_refusing(self) -> bool:
        """Whether commands have been refused that `news` has not told."""
        return self.refused != self._told_refused

    @property
    def text(self) -> str:
        """The driver's name, in plain words."""
        return driver_text(self.holder)

    def news(self, now_ns: int) -> OperatorState | None:
        """Return the state, if the others must be told.

        Args:
            now_ns: the module's time.
        """
        if not self.is_news and not (self.is_refusing and now_ns - self._told_ns >= REPEAT_NS):
            return None
        self.is_news = False
        self._told_ns, self._told_refused = now_ns, self.refused
        return OperatorState(
            robot=self.robot,
            operator=self.holder,
            since=Time.from_nanoseconds(self._since_ns),
            refused=self.refused,
            refused_operator=self.refused_operator,
        )

    def _give(self, operator: str, now_ns: int, utc_ns: int) -> None:
        self.holder, self._since_ns, self._heard_ns = operator, utc_ns, now_ns
        self.refused_operator = ""
        self.is_news = True
