"""Limits the number of connections, and the time of each request.

A connection without a session belongs to a stranger. Strangers share a small number of connections, and the
oldest one is closed to make room for the next. So half-open connections lock nobody out: a browser's request
is complete long before its connection is the oldest. Visitors with a session have separate connections.
"""

from __future__ import annotations

import asyncio
import ipaddress
import os
import resource
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.wsproto_impl import WSProtocol

from robbie_mp.base.errors import RobbieError
from robbie_mp.station.web.access import Role
from robbie_mp.station.web.listening import BACKLOG

REQUEST_LIMIT_S = 5.0
"""Time limit of a complete request, counted from the connection or from the request's first byte."""
MAX_STRANGERS = 48
MAX_STRANGERS_OF_ONE = 16
"""Maximum from one address, or one IPv6 network."""
MAX_BEHIND_PROXIES = 128
"""Maximum from all trusted proxies together: each brings the connections of all its browsers."""
MAX_VISITORS = 160
"""Maximum number of connections of all sessions."""
MAX_VISITORS_OF_ONE = 48
"""Maximum for one session: eight pages, each with four sockets and a few requests."""
RESERVED_DESCRIPTORS = 64
"""Number of descriptors reserved for the module's own files."""
MIN_VISITORS = 16
IPV6_NETWORK_BITS = 64
PROXIES = "trusted proxies"
"""The source of all their connections."""

Network = ipaddress.IPv4Network | ipaddress.IPv6Network


class TooFewDescriptors(RobbieError, OSError):
    """The limit on open files is too low to serve even one page."""


@dataclass(eq=False)
class Connection:
    """A connection to a browser.

    Args:
        transport: the transport of the connection.
        peer: address and port of the other end.
        source: the key by which strangers are counted.
    """

    transport: asyncio.BaseTransport
    peer: tuple[str, int]
    source: str
    session: str = ""
    role: Role | None = None


class Connections:
    """All open connections. Used only in the page server's event loop.

    Args:
        max_strangers: maximum number of connections without a session.
        max_visitors: maximum number of connections with a session.
        proxies: addresses and networks of trusted proxies.

    Attributes:
        dropped: number of connections closed to make room.
    """

    def __init__(
        self,
        max_strangers: int = MAX_STRANGERS,
        max_visitors: int = MAX_VISITORS,
        proxies: Sequence[str] = (),
    ):
        self.dropped = 0
        self._max_strangers = max_strangers
        self._max_visitors = max_visitors
        self._proxies = [ipaddress.ip_network(one) for one in proxies]
        self._strangers: dict[tuple[str, int], Connection] = {}
        self._visitors: dict[tuple[str, int], Connection] = {}

    def enter(self, transport: asyncio.BaseTransport) -> Connection:
        """Add a connection. If necessary, close the oldest one of the stranger with the most connections."""
        name = transport.get_extra_info("peername")
        peer = (str(name[0]), int(name[1])) if name else ("", id(transport))
        known = self._visitors.get(peer) or self._strangers.get(peer)
        if known is not None and known.transport is transport:
            return known
        made = Connection(transport, peer, source_of(peer[0], self._proxies))
        self._make_room_for_stranger(made.source)
        self._strangers[peer] = made
        return made

    def leave(self, connection: Connection) -> None:
        """Forget a closed connection."""
        for room in (self._strangers, self._visitors):
            if room.get(connection.peer) is connection:
                del room[connection.peer]

    def admit(self, peer: tuple[str, int] | None, session: str, role: Role) -> bool:
        """Count a connection for a session. Return whether there is room for it."""
        if peer is None or (connection := self._visitors.get(peer) or self._strangers.get(peer)) is None:
            return False
        if connection.session == session:
            return True
        own = sum(one.session == session for one in self._visitors.values())
        if own >= MAX_VISITORS_OF_ONE:
            return False
        if len(self._visitors) >= self._max_visitors and not self._make_room(role, own):
            return False
        self.leave(connection)
        connection.session, connection.role = session, role
        self._visitors[peer] = connection
        return True

    def end(self, session: str) -> None:
        """Close all connections of a session."""
        for one in [one for one in self._visitors.values() if one.session == session]:
            self._abort(one)

    def _make_room_for_stranger(self, source: str) -> None:
        sources = Counter(one.source for one in self._strangers.values())
        own = sources[source]
        del sources[PROXIES]  # they have a room of their own
        if own >= (MAX_BEHIND_PROXIES if source == PROXIES else MAX_STRANGERS_OF_ONE):
            self._drop_stranger(source)
        elif source != PROXIES and sources.total() >= self._max_strangers:
            self._drop_stranger(max(sources, key=lambda one: sources[one]))

    def _drop_stranger(self, source: str) -> None:
        self.dropped += 1
        self._abort(next(one for one in self._strangers.values() if one.source == source))

    def _make_room(self, role: Role, own: int) -> bool:
        """Close the newest connection of the session with most: an observer's, or one with more of them."""
        counts = Counter((one.role is Role.OBSERVER, one.session) for one in self._visitors.values())
        (is_observer, session), most = max(counts.items(), key=lambda item: (item[0][0], item[1]))
        if not (is_observer and role is Role.OPERATOR) and most <= own + 1:
            return False
        self.dropped += 1
        self._abort([one for one in self._visitors.values() if one.session == session][-1])
        return True

    def _abort(self, connection: Connection) -> None:
        self.leave(connection)
        cast(asyncio.Transport, connection.transport).abort()


class _Counted(asyncio.Protocol):
    """Counts a connection while it is open, before a protocol of uvicorn handles it.

    Args:
        rooms: where the connection is counted.
        more: the arguments of the protocol of uvicorn.
    """

    def __init__(self, rooms: Connections, **more: Any):
        super().__init__(**more)
        self._rooms = rooms
        self._connection: Connection | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Count the connection."""
        super().connection_made(transport)
        self._connection = self._rooms.enter(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop counting the connection."""
        if self._connection is not None:
            self._rooms.leave(self._connection)
        super().connection_lost(exc)


class BoundedHttp(_Counted, H11Protocol):
    """A counted connection on which every request must be complete within a time limit."""

    def __init__(self, rooms: Connections, **more: Any):
        super().__init__(rooms, **more)
        self._too_late: asyncio.TimerHandle | None = None
        self._is_upgraded = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first request."""
        super().connection_made(transport)
        self._too_late = self.loop.call_later(REQUEST_LIMIT_S, transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._stop_waiting()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take the received bytes, and wait a limited time for the rest of the request."""
        super().data_received(data)
        if self._is_upgraded or self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._stop_waiting()
        elif self._too_late is None:
            self._too_late = self.loop.call_later(REQUEST_LIMIT_S, self.transport.abort)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Leave the connection to another protocol."""
        self._is_upgraded = True
        super().handle_websocket_upgrade(event)

    def _stop_waiting(self) -> None:
        if self._too_late is not None:
            self._too_late.cancel()
            self._too_late = None


class BoundedWebSocket(_Counted, WSProtocol):
    """A counted WebSocket, which is closed if it requests answers without reading them."""

    def handle_ping(self, event: Any) -> None:
        """Answer a ping. The number of waiting answers is bounded."""
        if self.writable.is_set():
            super().handle_ping(event)
        else:
            self.transport.abort()


def source_of(address: str, proxies: Sequence[Network] = ()) -> str:
    """Return the key by which strangers are counted: their IPv4 address, IPv6 network, or `PROXIES`."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    found = getattr(found, "ipv4_mapped", None) or found
    if any(found in network for network in proxies):
        return PROXIES
    if isinstance(found, ipaddress.IPv6Address):
        return str(ipaddress.ip_network((found, IPV6_NETWORK_BITS), strict=False))
    return str(found)


def bounded_connections(proxies: Sequence[str]) -> Connections:
    """Return limits that fit the number of files that this process may open.

    Args:
        proxies: addresses and networks of trusted proxies.

    Raises:
        TooFewDescriptors: the process may open too few files.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    strangers = MAX_STRANGERS + (MAX_BEHIND_PROXIES if proxies else 0)
    free = limit - len(os.listdir("/proc/self/fd")) - RESERVED_DESCRIPTORS - strangers - BACKLOG
    # A request may open a file.
    visitors = min(MAX_VISITORS, free // 2)
    if visitors < MIN_VISITORS:
        raise TooFewDescriptors(
            f"an operator station needs {2 * (MIN_VISITORS - visitors)} more open files than the limit of "
            f"{limit} allows (RLIMIT_NOFILE): raise it, as with ulimit -n"
        )
    return Connections(max_visitors=visitors, proxies=proxies)
