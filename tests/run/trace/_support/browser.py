"""Opens a page in a real Chromium without a window, and has a script work in it."""

from pathlib import Path
from typing import Any

from tools.operator.chromium import chromium


def work_in(page: Path, script: str) -> Any:
    """Return what a JavaScript function body returns when the page has been loaded.

    Args:
        page: the page.
        script: the body of a function; it runs after the page's own scripts.
    """
    with chromium() as started:
        opened = started.new_page(viewport={"width": 1000, "height": 700})
        opened.goto(page.as_uri())
        return opened.evaluate(f"() => {{{script}}}")
