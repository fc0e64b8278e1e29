"""Access to the page: tokens, sessions, roles, and the origin of requests.

Every visitor needs a token, even on the robot's own machine, because other users may work there. A request
that another site makes a browser send is refused because of its origin (OWASP, Cross-Site Request Forgery
Prevention; RFC 6454).
"""

import hashlib
import hmac
import logging
import secrets
from collections import OrderedDict
from collections.abc import Mapping
from enum import IntEnum
from urllib.parse import urlsplit

MAX_SESSIONS = 64
"""Maximum for each role, so that observers end no operator's session. The least recently used one ends."""

LOG = logging.getLogger(__name__)


class Role(IntEnum):
    """The permissions of a visitor."""

    OBSERVER = 1
    """May see everything."""
    OPERATOR = 2
    """May also steer."""


class Access:
    """Checks tokens and sessions. It stores only their digests.

    Args:
        operator_token: token of operators.
        observer_token: token of observers; '': there are no observers.
        sessions: digests and roles of sessions from before a restart, for the same tokens.
        refusals: logs refused actions of visitors; its rate should be limited.
    """

    def __init__(
        self,
        operator_token: str,
        observer_token: str,
        sessions: Mapping[str, int] | None = None,
        refusals: logging.Logger = LOG,
    ):
        self.refusals = refusals
        self._tokens = {
            role: hashlib.sha256(token.encode()).digest()
            for role, token in ((Role.OPERATOR, operator_token), (Role.OBSERVER, observer_token))
            if token
        }
        self._sessions = OrderedDict((name, Role(role)) for name, role in (sessions or {}).items())

    @property
    def sessions(self) -> dict[str, int]:
        """The sessions as a restarted station needs them. They are digests, with which nobody can log in."""
        return {digest: int(role) for digest, role in tuple(self._sessions.items())}

    def log_in(self, token: str) -> str | None:
        """Return a new session for a token; None if it is wrong. Every token takes the same time."""
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
        """Return the role of a session, or None if there is no such session."""
        digest = digest_of(session or "")
        role = self._sessions.get(digest)
        if role is not None:
            self._sessions.move_to_end(digest)
        return role


def digest_of(session: str) -> str:
    """Return the digest of a session, from which nobody can compute the session."""
    return hashlib.sha256(session.encode("utf-8", "replace")).hexdigest()


def is_own_origin(origin: str | None, host: str | None, public: str = "") -> bool:
    """Return whether a request comes from our own page: its origin is the host to which it was sent.

    Args:
        origin: the origin that the browser names.
        host: the host that it or a proxy names.
        public: the origin of the page behind a proxy, which may name another host; '': none.
    """
    if origin is None or (public and origin.lower() == public):
        return True
    return host is not None and urlsplit(origin).netloc.lower() == host.lower()
