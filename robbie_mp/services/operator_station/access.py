"""Who may see and who may steer: tokens, sessions, and where requests may come from.

On the machine itself nobody is asked. Reached over a network, the page asks for one of two tokens of the
profile. Requests that another site makes a browser send are refused by their origin (OWASP, Cross-Site
Request Forgery Prevention; RFC 6454).
"""

import hmac
import ipaddress
import secrets
from collections import OrderedDict
from collections.abc import Mapping
from enum import IntEnum
from urllib.parse import urlsplit

SESSIONS = 64
"""So many are remembered; the one that was used least lately goes first."""
SHORTEST_TOKEN = 16
"""Longer than can be guessed. Wrong ones are traced, but not limited: that would lock the operator out."""


class Role(IntEnum):
    """What a visitor may do."""

    OBSERVER = 1
    """See everything."""
    OPERATOR = 2
    """Steer, too."""


def is_loopback(host: str) -> bool:
    """Whether an address to listen on is reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Access:
    """Knows tokens and sessions.

    Args:
        operator_token: '' lets everybody in as operator.
        observer_token: '' means that there are no observers.
        sessions: that were there before; for the same tokens.
    """

    def __init__(self, operator_token: str, observer_token: str, sessions: Mapping[str, int] | None = None):
        self._tokens = {
            role: token.encode()
            for role, token in ((Role.OPERATOR, operator_token), (Role.OBSERVER, observer_token))
            if token
        }
        self._sessions = OrderedDict((name, Role(role)) for name, role in (sessions or {}).items())

    @property
    def sessions(self) -> dict[str, int]:
        """What is to be known after a restart."""
        return {name: int(role) for name, role in tuple(self._sessions.items())}

    @property
    def is_open(self) -> bool:
        """Whether nobody is asked for a token."""
        return not self._tokens

    def log_in(self, token: str) -> str | None:
        """Return a new session for a token; None if it is wrong. Takes as long for any wrong token."""
        given, found = token.encode(), None
        for role, known in self._tokens.items():
            if hmac.compare_digest(given, known):
                found = role
        if found is None:
            return None
        session = secrets.token_urlsafe(32)
        self._sessions[session] = found
        while len(self._sessions) > SESSIONS:
            self._sessions.popitem(last=False)
        return session

    def role_of(self, session: str | None) -> Role | None:
        """Return what a session may do; None if there is no such session."""
        if self.is_open:
            return Role.OPERATOR
        role = self._sessions.get(session or "")
        if role is not None:
            self._sessions.move_to_end(session or "")
        return role


def is_own_origin(origin: str | None, host: str | None) -> bool:
    """Whether a request comes from a page of ours: its origin is the host that it asks."""
    return origin is None or (host is not None and urlsplit(origin).netloc.lower() == host.lower())


def is_local_name(host: str | None) -> bool:
    """Whether a request asks for this machine by a local name, and not by one from a stranger's DNS."""
    return host is not None and is_loopback(urlsplit(f"//{host}").hostname or "")


class DriversSeat:
    """At most one page drives at a time; another one takes over on purpose only."""

    def __init__(self) -> None:
        self.holder: str | None = None

    def take(self, page: str, *, over: bool = False) -> bool:
        """Sit down if the seat is free, or take it over; whether the page has it now."""
        if self.holder is None or over:
            self.holder = page
        return self.holder == page

    def leave(self, page: str) -> None:
        """Stand up."""
        if self.holder == page:
            self.holder = None
