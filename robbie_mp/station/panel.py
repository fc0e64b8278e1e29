"""What every panel of the page is: subscribed once, built for each page that is opened."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, ClassVar, Protocol

from nicegui import ui

from robbie_mp.station.access import Role

if TYPE_CHECKING:
    from robbie_mp.messages import Message
    from robbie_mp.station.station import OperatorStation


class Link(Protocol):
    """The connection to a browser."""

    @property
    def is_free(self) -> bool:
        """Whether the browser has taken what it was sent, all but a little."""


class Page:
    """One page that is open in a browser, and the only way from it to the robot.

    What a visitor may do is decided here, each time that he does it: an event can come from any element of
    his page, whether or not it is drawn, enabled or visible.

    Args:
        key: names it among all that are open.
        session: of its visitor.
        station: whose page it is.
        link: the connection to it.
    """

    def __init__(self, key: str, session: str, station: OperatorStation, link: Link):
        self.key = key
        self.session = session
        self.link = link
        self._station = station
        self.tab = ""
        """Name of the panel that is looked at."""

    @property
    def role(self) -> Role | None:
        """What its visitor may do now; None: nothing, for the session has ended."""
        return self._station.access.role_of(self.session)

    def may(self, what: str, needs: Role = Role.OPERATOR) -> bool:
        """Whether the visitor may do something now; if not, the page and the trace say so.

        Args:
            what: he wants, such as "the order".
            needs: the role for it.
        """
        role = self.role
        if role is not None and role >= needs:
            return True
        whose = "a session that has ended" if role is None else f"an {role.name.lower()}"
        self._station.refusals.warning("refused %s from a page of %s", what, whose)
        ui.notify(f"{what} was refused: it needs an {needs.name.lower()}", type="negative")
        return False

    def publish(self, message: Message, what: str, topic: str = "", needs: Role = Role.OPERATOR) -> bool:
        """Tell the robot something for the visitor, or tell him why not.

        Args:
            message: the message.
            what: it is, such as "the order".
            topic: of the message.
            needs: the role for it.

        Returns:
            Whether it was published: he may, and the robot's memory is not full.
        """
        if not self.may(what, needs):
            return False
        is_sent = self._station.publish(message, topic=topic)
        if not is_sent:
            ui.notify(f"{what} was not sent: the robot's memory is full", type="negative")
        return is_sent

    def every(self, period_s: float, panel: str, update: Callable[[], Awaitable[None] | None]) -> None:
        """Have something done while a panel is looked at, and not while it is not.

        An update that can be awaited, as one that waits for the browser, is over before the next one begins.
        """
        self.always(period_s, lambda: update() if self.tab == panel else None)

    def always(self, period_s: float, update: Callable[[], Awaitable[None] | None]) -> None:
        """Have something done on whatever panel; but not while the browser does not keep up with the rest."""
        ui.timer(period_s, lambda: update() if self.link.is_free else None)


class Panel(ABC):
    """One tab of the page.

    Args:
        station: the module; messages are subscribed to in the constructor, as a rule by `station.newest`, and
            published from any thread.
    """

    name: ClassVar[str]
    """By which the profile arranges it."""
    title: ClassVar[str]
    icon: ClassVar[str]
    """A name of the Material Icons that come with NiceGUI."""

    def __init__(self, station: OperatorStation):
        self.station = station

    @classmethod
    def is_wanted(cls, _station: OperatorStation) -> bool:
        """Whether it has anything to show, where the profile does not say which panels there are."""
        return True

    @property
    def is_looked_at(self) -> bool:
        """Whether any page shows it; what nobody looks at need not be prepared."""
        return any(page.tab == self.name for page in tuple(self.station.pages.values()))

    def tick(self) -> None:  # noqa: B027 - most panels have nothing to do
        """Do what is done once for all pages; runs in the module's thread, at each of its ticks."""

    def close(self) -> None:  # noqa: B027
        """Let go of what was opened."""

    @abstractmethod
    def build(self, page: Page) -> None:
        """Make the panel's elements for a page; runs in the page server's thread, and must not block."""
