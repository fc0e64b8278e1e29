"""A page that is open in a browser, and the only way from it to the robot."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol

from nicegui import ui

from robbie_mp.messages import IllFormed, NavigateTo, PlaybackControl, check_well_formed
from robbie_mp.module.calls.errors import CallRefused, GoalAborted, GoalCancelled, GoalPreempted
from robbie_mp.station.driving.dead_man import ORDER_LIMIT_S, DeadManSwitch
from robbie_mp.station.live.network import PageNetwork
from robbie_mp.station.web.access import Role

if TYPE_CHECKING:
    from robbie_mp.messages import Message
    from robbie_mp.station.module import StationModule
    from robbie_mp.station.page.requests import Asked, Asking
    from robbie_mp.station.web.access import Access

CONTROL = PlaybackControl.type_name
"""The type of the only messages that a page which shows the past may publish."""


class PageLink(Protocol):
    """The connection to a browser."""

    @property
    def is_free(self) -> bool:
        """Whether the browser has received almost everything that was sent."""


class KeyAction(NamedTuple):
    """An action that a key starts."""

    text: str
    action: Callable[[], Awaitable[None] | None] | None


class Drives(Protocol):
    """Drives the robot for an operator's page.

    Attributes:
        linear_m_per_s: speed while a control is held to its end.
        angular_rad_per_s: turn rate while a control is held to its end.
        without_guard: whether this drive is not guarded against collisions; ends when the operator lets go.
        slowed: the share of these speeds that the age of the operator's picture allows.
    """

    linear_m_per_s: float
    angular_rad_per_s: float
    without_guard: bool
    slowed: float

    @property
    def refused(self) -> int:
        """Number of commands refused here because an operator elsewhere drives."""

    @property
    def stale(self) -> int:
        """Number of commands that came too late."""

    @property
    def is_other_driving(self) -> bool:
        """Whether another page, or an operator elsewhere, drives."""

    @property
    def delay(self) -> str:
        """Why the network does not allow to drive; '' if it does."""

    def take_over(self) -> None:
        """Drive instead of the page or the operator elsewhere that drives now."""

    def change_limits(self, up: bool) -> None:
        """Drive faster or slower from now on."""


class Page:
    """One page that is open in a browser, and the only way from it to the robot.

    Permissions are checked here, on every action: an event can come from any element of the page, whether
    or not it is drawn, enabled or visible.

    Args:
        key: identifies the page among all open ones.
        session: the visitor's session.
        access: knows the role of the session.
        station: sends messages to the robot.
        link: the connection to the browser.
    """

    def __init__(self, key: str, session: str, access: Access, station: StationModule, link: PageLink):
        self.key = key
        self.session = session
        self.link = link
        self._access = access
        self._station = station
        self._asked: list[tuple[Asked, str]] = []
        """The requests that have not ended yet, each with the text to show when it succeeds."""
        self.goal: Asked | None = None
        """The newest goal that the page has set for the robot to drive to."""
        self._timers: list[tuple[str, ui.timer]] = []
        """The timers of panels, which run only while the page shows these."""
        self.shown: frozenset[str] = frozenset()
        """Names of the panels that the page shows now."""
        self.shows_past = False
        """Whether it plays a clip, so that nobody there can order anything."""
        self.plays_log = False
        """Whether it shows a log or a clip, and no live robot: what moves one is neither shown nor sent."""
        self.dead_man = DeadManSwitch()
        self.network = PageNetwork()
        self.driver: Drives | None = None
        """Drives for an operator; None on an observer's page."""
        self.keys: dict[str, KeyAction] = {}
        """Actions by the keys that start them."""

    @property
    def role(self) -> Role | None:
        """The visitor's role now; None if the session has ended."""
        return self._access.role_of(self.session)

    @property
    def can_command(self) -> bool:
        """Whether to build what commands the robot: for an operator, beside a live one."""
        return self.role is Role.OPERATOR and not self.plays_log

    def may(self, what: str, needs: Role = Role.OPERATOR) -> bool:
        """Return whether the visitor may do something now. If not, report it on the page and in the trace.

        Args:
            what: the action, such as "the order".
            needs: the role that the action needs.
        """
        role = self.role
        if role is not None and role >= needs:
            return True
        whose = "a session that has ended" if role is None else f"an {role.name.lower()}"
        self._access.refusals.warning("refused %s from a page of %s", what, whose)
        ui.notify(f"{what} was refused: it needs an {needs.name.lower()}", type="negative")
        return False

    def _is_past(self, what: str) -> bool:
        """Return whether the page shows the past, where nobody can order anything, and report that."""
        if not self.shows_past:
            return False
        ui.notify(f"{what} was refused: this is the past; go back to live", type="negative")
        return True

    def may_move(self, what: str) -> bool:
        """Return whether the visitor may give an order that lets the robot move. It must not be late."""
        if not self.may(what):
            return False
        if self.plays_log:
            ui.notify(f"{what} was refused: a log plays, and no robot would move", type="negative")
            return False
        if self.dead_man.is_prompt(time.monotonic()):
            return True
        self._access.refusals.warning("refused %s of a page: it may have waited too long", what)
        ui.notify(f"{what} was refused: it may have waited too long; give it again", type="negative")
        return False

    def publish(self, message: Message, what: str, topic: str = "", needs: Role = Role.OPERATOR) -> bool:
        """Publish a message for the visitor, or show on the page why not.

        Args:
            message: the message.
            what: a name for the message in texts, such as "the order".
            topic: topic of the message.
            needs: the role that the action needs.

        Returns:
            Whether it was published. It is not if the visitor lacks the role, the message is ill-formed, or
            the robot's memory is full.
        """
        if not self.may(what, needs) or (message.type_name != CONTROL and self._is_past(what)):
            return False
        try:
            check_well_formed(message)
        except IllFormed as error:
            self._station.ill_formed.count(error, f"{what} of a page")
            ui.notify(f"{what} was refused: {error}", type="negative")
            return False
        is_sent = self._station.publish(message, topic=topic)
        if not is_sent:
            ui.notify(f"{what} was not sent: the robot's memory is full", type="negative")
        return is_sent

    def ask(
        self, message: Asking, what: str, success: str = "", topic: str = "", *, moves: bool = False
    ) -> Asked | None:
        """Send a request or a goal for an operator. Whatever ends it is shown on the page.

        Args:
            message: the request or goal, for the module that serves it.
            what: a name for it in texts, such as "the order".
            success: shown when the reply or result arrives; '' shows nothing.
            topic: name of the service, if several modules serve the same type.
            moves: whether it lets the robot move: then it is refused if it is late.

        Returns:
            How it ends, in a while; None if the visitor lacks the role, or it is late.
        """
        if self._is_past(what) or not (self.may_move(what) if moves else self.may(what)):
            return None
        asked = self._station.ask(message, what, topic, within_s=ORDER_LIMIT_S if moves else None)
        self._asked.append((asked, success))
        if isinstance(message, NavigateTo):
            self.goal = asked
        return asked

    def show_ends(self) -> None:
        """Show how requests and goals have ended."""
        for entry in [entry for entry in self._asked if entry[0].has_ended]:
            self._asked.remove(entry)
            asked, success = entry
            if asked.error is not None:
                ui.notify(ending(asked), type="negative", timeout=8000)
            elif success:
                ui.notify(success, type="positive")

    def add_key(
        self, key: str, text: str, action: Callable[[], Awaitable[None] | None] | None = None
    ) -> None:
        """Let a key start an action wherever the focus is, but for texts; `?` lists it.

        Args:
            key: the character, in lower case, or a gamepad's button that keyboard.js knows. If another
                action has it already, that one keeps it.
            text: what it does.
            action: called in the page server's thread; None: a script of the page listens itself.
        """
        self.keys.setdefault(key, KeyAction(text, action))

    def every(self, period_s: float, panel: str, update: Callable[[], Awaitable[None] | None]) -> None:
        """Call an update periodically while the page shows a panel.

        If the update is a coroutine, it ends before the next one begins.
        """
        timer = self.always(period_s, update)
        timer.active = panel in self.shown
        self._timers.append((panel, timer))

    def always(self, period_s: float, update: Callable[[], Awaitable[None] | None]) -> ui.timer:
        """Call an update periodically whatever the page shows, except while the browser does not keep up.

        While the network is late, it is called more rarely.
        """
        credit = 0.0

        def tick() -> Awaitable[None] | None:
            nonlocal credit
            credit = min(2.0, credit + self.network.share)
            if credit < 1.0 or not self.link.is_free:
                return None
            credit -= 1.0
            return update()

        return ui.timer(period_s, tick)

    def show(self, panels: frozenset[str]) -> None:
        """Show these panels, and update no others."""
        self.shown = panels
        for panel, timer in self._timers:
            timer.active = panel in panels


def ending(asked: Asked) -> str:
    """Return a text that says why a request or goal has failed."""
    match asked.error:
        case CallRefused():
            return f"{asked.what} was refused: {asked.error}"
        case GoalCancelled():
            return f"{asked.what} was cancelled: {asked.error}"
        case GoalPreempted():
            return f"{asked.what} was given up: {asked.error}"
        case GoalAborted():
            return f"{asked.what} cannot be reached: {asked.error}"
        case _:
            return f"{asked.what} failed: {asked.error}"
