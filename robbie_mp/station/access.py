"""Access to the page: tokens, sessions, roles, and the origin of requests.

Every visitor needs a token, on the robot's own machine too, since others may use it. Requests that
another site makes a browser send are refused by their origin (OWASP, Cross-Site Request Forgery Prevention;
RFC 6454).
"""

import hashlib
import hmac
import ipaddress
import secrets
from collections import OrderedDict
from collections.abc import Mapping
from enum import IntEnum
from urllib.parse import urlsplit

MAX_SESSIONS = 64
"""Of each role. The least recently used one is ended first, so observers never end an operator's session."""
MIN_TOKEN_CHARACTERS = 16
"""Characters; too many to guess at the rate at which wrong tokens are accepted."""


class Role(IntEnum):
    """What a visitor may do."""

    OBSERVER = 1
    """See everything."""
    OPERATOR = 2
    """Steer, too."""


def is_loopback(host: str) -> bool:
    """Whether an address to listen on can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Access:
    """Knows the tokens and sessions; it keeps only their digests.

    Args:
        operator_token: logs an operator in.
        observer_token: logs an observer in; '': there are no observers.
        sessions: digests and roles of sessions from before a restart, for the same tokens.
    """

    def __init__(self, operator_token: str, observer_token: str, sessions: Mapping[str, int] | None = None):
        self._tokens = {
            role: hashlib.sha256(token.encode()).digest()
            for role, token in ((Role.OPERATOR, operator_token), (Role.OBSERVER, observer_token))
            if token
        }
        self._sessions = OrderedDict((name, Role(role)) for name, role in (sessions or {}).items())

    @property
    def sessions(self) -> dict[str, int]:
        """What a restarted station needs; digests, with which no one can log in."""
        return {digest: int(role) for digest, role in tuple(self._sessions.items())}

    def log_in(self, token: str) -> str | None:
        """Return a new session for a token; None if it is wrong. It takes the same time for any token."""
        given, found = hashlib.sha256(token.encode("utf-8", "replace")).digest(), None
        for role, known in self._tokens.items():
            if hmac.compare_digest(given, known):
                found = role
        if found is None:
            return None
        session = secrets.token_urlsafe(32)
        self._sessions[digest_of(session)] = found
        same = [digest for digest, role in self._sessions.items() if role is found]
        for digest in same[:-MAX_SESSIONS]:
            del self._sessions[digest]
        return session

    def log_out(self, session: str) -> None:
        """End a session for good."""
        self._sessions.pop(digest_of(session), None)

    def role_of(self, session: str | None) -> Role | None:
        """Return what a session may do; None if there is no such session."""
        digest = digest_of(session or "")
        role = self._sessions.get(digest)
        if role is not None:
            self._sessions.move_to_end(digest)
        return role


def digest_of(session: str) -> str:
    """Return the digest under which a session is kept; the session cannot be found from it."""
    return hashlib.sha256(session.encode("utf-8", "replace")).hexdigest()


def is_own_origin(origin: str | None, host: str | None) -> bool:
    """Whether a request comes from a page of ours: its origin is the host that it asks."""
    return origin is None or (host is not None and urlsplit(origin).netloc.lower() == host.lower())


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
