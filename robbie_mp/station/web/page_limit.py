"""Limits the number of open pages, because each costs memory and processor time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from nicegui.client import Client
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from robbie_mp.station.page.cockpit import TILE_PATH
from robbie_mp.station.web.gate import SESSION, App

if TYPE_CHECKING:
    from robbie_mp.station.page.page import Page
    from robbie_mp.station.web.access import Access

MAX_PAGES = 16
"""Maximum number of all operators' pages. Observers have a separate limit, so they lock out no operator."""
MAX_PAGES_OF_ONE = 8
"""Maximum number of pages of one session."""
CONNECT_LIMIT_S = 10.0
"""A page loaded longer ago than this that is not connected may be deleted to make room for another."""


def with_page_limit(app: App, access: Access, pages: Mapping[str, Page]) -> App:
    """Return an application that loads a page only if there is room for one more."""
    limit = PageLimit(access, pages)

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not is_page(scope["path"]):
            await app(scope, receive, send)
        elif limit.has_room(scope[SESSION]):
            with limit.being_made(scope[SESSION]):
                await app(scope, receive, send)
        else:
            text = "too many pages are open; close some, or try again in a few seconds\n"
            access.refusals.warning("refused a page: too many are open")
            refusal = PlainTextResponse(text, 503, {"Retry-After": f"{CONNECT_LIMIT_S:.0f}"})
            await refusal(scope, receive, send)

    return answer


def is_page(path: str) -> bool:
    """Return whether a path is that of a page, with layouts or with one tile."""
    return path == "/" or path.startswith(TILE_PATH)


class PageLimit:
    """Counts the open pages and those that are being built.

    Args:
        access: knows the role of each session.
        pages: the open pages.
    """

    def __init__(self, access: Access, pages: Mapping[str, Page]):
        self._role_of = access.role_of
        self._pages = pages
        self._being_made: list[str] = []

    @contextmanager
    def being_made(self, session: str) -> Iterator[None]:
        """Count a page while it is being built."""
        self._being_made.append(session)
        try:
            yield
        finally:
            self._being_made.remove(session)

    def has_room(self, session: str) -> bool:
        """Make room for a page by deleting abandoned ones if necessary. Return whether there is room."""
        role = self._role_of(session)
        same = [page for page in self._pages.values() if page.role is role]
        own = [page for page in same if page.session == session]
        own_waiting = self._being_made.count(session)
        waiting = sum(self._role_of(one) is role for one in self._being_made)
        return make_room(own, MAX_PAGES_OF_ONE - own_waiting) and make_room(same, MAX_PAGES - waiting)


def make_room(pages: list[Page], limit: int) -> bool:
    """Delete abandoned pages, the oldest first, to get below a limit. Return whether that was possible."""
    alive = [page for page in pages if page.key in Client.instances]
    surplus = len(alive) - limit + 1
    for page in alive:
        client = Client.instances[page.key]
        is_old = client.created < time.time() - CONNECT_LIMIT_S
        if surplus > 0 and is_old and not client.has_socket_connection:
            client.delete()
            surplus -= 1
    return surplus <= 0
