"""Measures how long the robot drives on after a failure of the page, its server or the link."""

import signal
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

from playwright.sync_api import Browser, Page

from tools.operator.stops.cut_link import HERE, CutLink
from tools.operator.stops.scene import Event, Scene

KEYS = ("KeyW", "KeyS")
"""Forwards and backwards in turn, so that the robot stays in the hall."""


def close_page(_scene: Scene, page: Page) -> int:
    """Close the page as a user does."""
    at_ns = time.monotonic_ns()
    page.close()
    return at_ns


def stop_server(scene: Scene, _page: Page) -> int:
    """Stop the page server."""
    return scene.send("operator", signal.SIGSTOP)


def kill_server(scene: Scene, page: Page) -> int:
    """Kill the page server. The page will reload when the server is back."""
    page.evaluate("window.is_old = true")
    return scene.send("operator", signal.SIGKILL)


def open_anew(_scene: Scene, _page: Page) -> None:
    """Do nothing: the next trial opens a new page."""


def let_go_on(scene: Scene, page: Page) -> None:
    """Resume the stopped server."""
    scene.send("operator", signal.SIGCONT)
    page.keyboard.up(KEYS[0])
    page.keyboard.up(KEYS[1])


def wait_for_page(scene: Scene, page: Page) -> None:
    """Wait until the page is connected to the restarted server."""
    page.wait_for_function("!window.is_old && window.did_handshake")
    scene.wait_for_page(page)
    page.keyboard.up(KEYS[0])
    page.keyboard.up(KEYS[1])


EVENTS: dict[str, tuple[Callable[[Scene, Page], int], Callable[[Scene, Page], None]]] = {
    "page closed": (close_page, open_anew),
    "server stopped": (stop_server, let_go_on),
    "server killed": (kill_server, wait_for_page),
}
"""For each event, the function that causes it and the function that undoes it."""


def until_it_stands(scene: Scene, page: Page, key: str, event: Event) -> float:
    """Drive, cause an event, and return how long the robot drove on (s) according to the base's odometry."""
    scene.drive(page, key)
    at_ns = event()
    return (scene.wait_for("speed", 0.0, at_ns) - at_ns) / 1e9


def trials(scene: Scene, browser: Browser, name: str, count: int) -> list[float]:
    """Return how long the robot drove on (s) in each trial of an event."""
    found = []
    happens, restore = EVENTS[name]
    with ExitStack() as pages:
        page = pages.enter_context(scene.page(browser, "127.0.0.1"))
        for number in range(count):
            if page.is_closed():
                pages.close()
                page = pages.enter_context(scene.page(browser, "127.0.0.1"))
            found.append(until_it_stands(scene, page, KEYS[number % 2], partial(happens, scene, page)))
            restore(scene, page)
    return found


def cut_trials(scene: Scene, browser: Browser, link: CutLink, count: int) -> list[float]:
    """Return the same for trials that cut the link. All use one page, which connects again each time."""
    found = []
    with scene.page(browser, HERE) as page:
        for number in range(count):
            key = KEYS[number % 2]

            def cut() -> int:
                at_ns = time.monotonic_ns()
                link.cut()
                return at_ns

            found.append(until_it_stands(scene, page, key, cut))
            page.keyboard.up(key)
            link.restore()
    return found
