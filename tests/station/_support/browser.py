"""A real Chromium without a window, in which tests look at the page and use it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page
from playwright.sync_api import Error as PlaywrightError
from playwright.sync_api import TimeoutError as PlaywrightTimeout

from tests._support.robot import LIMIT_S
from tools.operator.chromium import CHROMIUM, chromium

browser = chromium
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None,
    reason="PAGES ARE NOT TESTED: no Chromium; try apt-get install chromium-headless-shell",
)
DRIVER = "GL Driver Message (OpenGL, Performance"
"""The warning of a browser that draws without a graphics card."""
GIVEN_UP = "/emergency-stop' failed: WebSocket is closed before the connection is established"
"""Its message when the page drops a connection that takes too long, as on a busy machine, for another."""
TABLET: dict[str, Any] = {"viewport": {"width": 768, "height": 1024}, "has_touch": True}
LAPTOP: dict[str, Any] = {"viewport": {"width": 1280, "height": 800}}
COMPLAINTS = ("error", "warning")
ATTEMPTS, ATTEMPT_MS = 5, 15_000
MAX_SHOWN = 2000
"""Maximum number of characters that a failed test says of a page."""
IS_CONNECTED = "window.did_handshake && window.socket.connected"
"""The connection of all that is not the emergency stop; on a busy machine it comes later than that."""
CONNECTION = "window.socket.id"
READY = "#emergency-stop-state:text-is('ready')"
REFUSED = ".q-notification:has-text('it may have waited too long; give it again')"
HELD_MS = 300
"""A hand holds a key for a while. If a dialog closes when it goes down, its release gets elsewhere."""
RECONNECTING = (
    "WebSocket connection to",
    "WebSocket is already in CLOSING or CLOSED state",
    "Failed to load resource: net::ERR_",
)
"""Begins what a browser says of a server that is gone for a moment."""


@contextmanager
def page_of(
    started: Browser,
    address: str,
    device: dict[str, Any] = LAPTOP,
    *,
    may_say: Sequence[str] = (),
    script: str = "",
) -> Iterator[Page]:
    """Open a page; whatever else than `may_say` its console complains of is an error at the end.

    Args:
        started: the browser.
        address: of the page.
        device: what the browser looks like.
        may_say: beginnings of what the console may complain of.
        script: runs before the page's own.
    """
    said: list[str] = []
    context = started.new_context(**device)
    page = context.new_page()
    page.set_default_timeout(1000 * LIMIT_S)
    page.add_init_script(script)

    def note(message: ConsoleMessage) -> None:
        if message.type in COMPLAINTS:
            said.append(message.text)

    page.on("console", note)
    page.on("pageerror", lambda error: said.append(str(error)))
    try:
        page.goto(address)
        yield page
    except BaseException:
        print(f"The console said {said}. The page at {page.url} shows:\n{_shown(page)}")
        with suppress(PlaywrightError):
            context.close()  # or it would keep drawing, and driving, beside the next test
        raise
    context.close()
    unexpected = [
        text
        for text in said
        if DRIVER not in text and GIVEN_UP not in text and not text.startswith(tuple(may_say))
    ]
    assert not unexpected, unexpected


def choose_layout(page: Page, number: int, name: str) -> None:
    """Press a layout's key. A page that is just connecting again, on a busy machine, does not hear it."""
    for _ in range(ATTEMPTS):
        page.keyboard.press(str(number))
        with suppress(PlaywrightTimeout):
            page.wait_for_selector(f"#layouts:has-text('{name}')", timeout=ATTEMPT_MS)
            return
    raise AssertionError(f"the page does not show {name}")


def press_until(
    page: Page, button: str, wanted: str, press: Callable[[Page, str], None] = Page.click
) -> None:
    """Press again if nothing comes of it: the server drops a browser that is slow to answer."""
    for _ in range(ATTEMPTS):
        page.wait_for_function(IS_CONNECTED)
        press(page, button)
        with suppress(PlaywrightTimeout):
            page.wait_for_selector(wanted, timeout=ATTEMPT_MS)
            return
    raise AssertionError(f"{button} has no effect")


def begin_drawing(page: Page, what: str) -> None:
    """Choose on the map what to draw, such as `no_go`."""
    press_until(page, "#map-draw", f"#map-draw-{what}")
    page.click(f"#map-draw-{what}")
    page.wait_for_selector(f"#map-view[data-placing={what}]")
    page.wait_for_selector(".q-menu", state="detached")  # it lies above the map


def open_panel(page: Page, name: str) -> None:
    """Show a panel alone."""
    press_until(page, f"#tab-{name}", f"#panel-{name}")


def dialog_is_gone(page: Page) -> None:
    """Wait for it. While it is open it takes the focus; while it fades out, its buttons do not hear keys."""
    page.wait_for_selector(".q-dialog__inner", state="detached")


def release(page: Page, press: Callable[[Page, str], None] = Page.click) -> None:
    """Release the emergency stop.

    Release it again if the page says that the robot refused it because it came late, or if the connection was
    lost, as on a busy machine.

    Args:
        page: the page of an operator.
        press: presses a button.
    """
    for _ in range(ATTEMPTS):
        page.wait_for_function(IS_CONNECTED)
        connection = page.evaluate(CONNECTION)
        if not page.is_visible("#confirm-release"):
            press_until(page, "#release-emergency-stop", "#confirm-release", press)
        press(page, "#confirm-release")
        try:
            answer = page.wait_for_selector(f"{READY}, {REFUSED}", timeout=ATTEMPT_MS)
        except PlaywrightTimeout:
            assert page.evaluate(CONNECTION) != connection, (
                "a release had no effect, and the page says nothing"
            )
            continue
        dialog_is_gone(page)
        if answer and answer.get_attribute("id") == "emergency-stop-state":
            return
        page.wait_for_selector(REFUSED, state="detached")
    raise AssertionError(f"the robot was not released by {ATTEMPTS} orders")


def _shown(page: Page) -> str:
    """Return the beginning and the end of a page's text, or why there is none. Dialogs are at the end."""
    try:
        text = page.inner_text("body", timeout=1000)
        return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN // 2]} […] {text[-MAX_SHOWN // 2 :]}"
    except PlaywrightError as error:
        return f"nothing ({error})"
