"""Which operator has control of the robot, as this station sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robbie_mp.connect.link.operators import REQUEST_TOPIC, driver_text
from robbie_mp.messages import LinkState, OperatorRequest, OperatorState

if TYPE_CHECKING:
    from robbie_mp.messages import uint8
    from robbie_mp.station.module import Publish
    from robbie_mp.station.watch.latest import MessageSource


class RobotCommand:
    """Knows who has control of a robot that has a link. Without a link, only the pages share it.

    Args:
        source: receives what the link says.
        publish: sends requests to the robot.
    """

    def __init__(self, source: MessageSource, publish: Publish):
        self._publish = publish
        self._state = source.newest(OperatorState)
        self._link = source.newest(LinkState)

    @property
    def _own(self) -> str:
        """The name of this side of the link; '' while it is not known."""
        return self._link.message.robot if self._link.message is not None else ""

    @property
    def is_here(self) -> bool:
        """Whether this is the robot's own page, whose commands no link can refuse."""
        return self._state.message is not None and self._state.message.robot == self._own

    @property
    def is_elsewhere(self) -> bool:
        """Whether the robot is at another side of a link, which no call passes."""
        return self._state.message is not None and self._own not in ("", self._state.message.robot)

    @property
    def other(self) -> str:
        """The operator elsewhere who has control; '': nobody, or this station."""
        state = self._state.message
        return "" if state is None or state.operator == self._own else state.operator

    @property
    def rival(self) -> str:
        """The operator elsewhere whose commands are refused, while this station has control."""
        state = self._state.message
        return "" if state is None or state.operator != self._own else state.refused_operator

    @property
    def text(self) -> str:
        """The driver's name, if an operator elsewhere drives; '' otherwise."""
        return driver_text(self.other) if self.other else ""

    def take(self, *, over: bool = False) -> None:
        """Ask for the command, if the robot has a link and this station does not hold it. Any thread may.

        Args:
            over: even if another operator holds it.
        """
        state = self._state.message
        if state is not None and (not state.operator or (over and self.other)):
            self.ask(OperatorRequest.TAKE_OVER if over else OperatorRequest.TAKE)

    def give_up(self) -> None:
        """Give up control, so that the next operator who drives gets it. Any thread may."""
        state = self._state.message
        if state is not None and state.operator and not self.other:
            self.ask(OperatorRequest.GIVE_UP)

    def ask(self, wish: uint8) -> None:
        """Send a wish, a constant of `OperatorRequest`, to the robot. Any thread may."""
        self._publish(OperatorRequest(wish=wish), topic=REQUEST_TOPIC)
