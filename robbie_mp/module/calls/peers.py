"""The other modules as a caller must know them."""

import time
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.board import TOOL_PREFIX, Board
from robbie_mp.bus.transport.channels import messages_waiting
from robbie_mp.bus.transport.declarations import read_declarations
from robbie_mp.bus.transport.tables import ROW_OPEN, ChannelName, CoreTables, SubscriptionRow
from robbie_mp.bus.transport.words import Words
from robbie_mp.module.wiring import SERVICE_TOPIC, UNCHANGED, Wiring

_UNKNOWN = -1


def service_topic(topic: str) -> str:
    """Return the topic on which the requests of a service travel; only its server subscribes to it."""
    return f"{SERVICE_TOPIC}/{topic}" if topic else SERVICE_TOPIC


def topic_of_service(topic: str) -> str | None:
    """Return the `topic` of `service_topic`; None if requests do not travel on this topic."""
    kind, _, name = topic.partition("/")
    return name if kind == SERVICE_TOPIC else None


class Server(NamedTuple):
    """A module that serves requests."""

    module: str
    slot: int
    service: ChannelName
    row: int = _UNKNOWN
    """Index of its subscription in the core's table."""


class Peers(Protocol):
    """The other modules of the run, and this module's own place among them."""

    can_serve: bool
    """Whether this module may serve."""

    @property
    def name(self) -> str:
        """The name under which this module publishes."""

    @property
    def incarnation(self) -> int:
        """Number of this module's process."""

    def now_ns(self) -> int:
        """The machine's monotonic time."""

    def find_server(self, service: ChannelName) -> Server | None:
        """Return the module that serves requests of a type, version and topic."""

    def serves(self, server: Server) -> bool:
        """Whether a server still serves, although it may be restarting just now."""

    def is_same(self, server: Server, incarnation: int) -> bool:
        """Whether a server that was found earlier still serves, with the same process as then."""

    def incarnation_of(self, server: Server) -> int:
        """Return the number of a server's newest process."""

    def end_of(self, server: Server) -> str:
        """Describe why a server serves no longer."""

    def rival(self, service: ChannelName) -> str | None:
        """Return another module that serves the same and takes precedence over this one."""


class RunPeers:
    """The modules of a live run, read from the board and the core's table; see `Peers`.

    Args:
        run_id: the run.
        slot, incarnation: of this module.
        core: the core segment.
        board: the board.
        wiring: the names that the profile gives to the module's topics, and so to its services.
    """

    def __init__(
        self,
        run_id: str,
        slot: int,
        incarnation: int,
        core: Words,
        board: Board,
        wiring: Wiring = UNCHANGED,
    ):
        self._run_id = run_id
        self._slot = slot
        self.incarnation = incarnation
        self._tables = CoreTables.attach(core)
        self._board = board
        self._wiring = wiring
        self.name = board.name(slot)
        self.can_serve = not self.name.startswith(TOOL_PREFIX)

    now_ns = staticmethod(time.monotonic_ns)

    @property
    def may_go(self) -> bool:
        """Whether every module of the run is ready."""
        return self._board.may_go

    def have_sent_more(self) -> bool:
        """Whether messages wait for this module in the core."""
        return messages_waiting(self._tables.words, self._slot) > 0

    def find_server(self, service: ChannelName) -> Server | None:
        """Return the module that serves requests; if there are several, the one that is started first."""
        return min(self._servers(self._actual(service)), key=lambda server: server.slot, default=None)

    def serves(self, server: Server) -> bool:
        """Whether a server's subscription is still open."""
        if server.row == _UNKNOWN:
            return any(found.slot == server.slot for found in self._servers(server.service))
        return self._is_open(self._tables.subscription_row(server.row), server)

    def is_same(self, server: Server, incarnation: int) -> bool:
        """Whether a server still serves, with the same process as when it was found.

        The process keeps its subscriptions until it ends, so the name in the row need not be read again.
        """
        if self.incarnation_of(server) != incarnation:
            return False
        if server.row == _UNKNOWN:
            return self.serves(server)
        row, words = self._tables.subscription(server.row), self._tables.words
        return (
            words[row + layout.SUBSCRIPTION_STATE] == ROW_OPEN
            and words[row + layout.SUBSCRIPTION_SLOT] == server.slot
        )

    def incarnation_of(self, server: Server) -> int:
        """Return the number of a server's newest process."""
        return self._board.incarnation(server.slot)

    def end_of(self, server: Server) -> str:
        """Describe why a server serves no longer."""
        return self._board.read(server.slot).reason

    def rival(self, service: ChannelName) -> str | None:
        """Return a module that serves the same and that the profile starts before this one."""
        found = (server for server in self._servers(self._actual(service)) if server.slot < self._slot)
        return next((server.module for server in found), None)

    def _actual(self, service: ChannelName) -> ChannelName:
        return service._replace(topic=self._wiring.actual(service.type_name, service.topic))

    def _is_open(self, row: SubscriptionRow, server: Server) -> bool:
        return row.state == ROW_OPEN and row.slot == server.slot and row.name == server.service

    def _servers(self, service: ChannelName) -> Iterator[Server]:
        """Yield the servers that the core knows, or else those that it will know after reading its rings."""
        found = False
        for row in self._tables.subscriptions():
            if row.state == ROW_OPEN and row.name == service:
                module = self._board.name(row.slot)
                if not module.startswith(TOOL_PREFIX):
                    found = True
                    yield Server(module, row.slot, service, row.index)
        if found:
            return
        modules = self._board.modules()
        for entry in read_declarations(self._run_id):
            if not entry.is_publisher and entry.name == service and entry.module in modules:
                yield Server(entry.module, modules.index(entry.module) + 1, service)
