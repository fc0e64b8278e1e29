"""A real Chromium without a window, in which tests look at the page and use it."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None,
    reason="THE OPERATOR'S PAGE IS NOT TESTED: no Chromium here; on Debian: apt-get install chromium",
)
ARGUMENTS = [
    "--no-sandbox",  # tests may run as root
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
]
DRIVER = "GL Driver Message (OpenGL, Performance"
"""What a machine without a graphics card says of its own drawing."""
TABLET = {"width": 800, "height": 1280}
LAPTOP = {"width": 1280, "height": 800}


@contextmanager
def browser() -> Iterator[Browser]:
    """Start a browser, and end it with all that it has started."""
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield started
        started.close()


@contextmanager
def page_of(started: Browser, address: str, size: dict[str, int] = LAPTOP) -> Iterator[Page]:
    """Open a page; whatever it says on its console is an error at the end."""
    said: list[str] = []
    context = started.new_context(viewport=size)  # type: ignore[arg-type]
    page = context.new_page()
    page.on("console", lambda message: DRIVER in message.text or said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(address)
    yield page
    context.close()
    assert not said, said
