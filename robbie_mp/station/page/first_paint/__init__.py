"""What the page loads first: the icons and styles that our own panels use, in one small file.

NiceGUI's own font of icons and its compiler of styles are 200 kB, and take a second of the browser. They
come after the first picture, and only to a page that has panels from elsewhere, which may use any of them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

import nicegui
from nicegui import app

HERE = Path(__file__).parent
STYLE = HERE / "first_paint.css"
"""Written by `tools.operator.first_paint`."""
OUR_PACKAGES = ("robbie_mp", "robbie_robots")
YEAR_S = 31_536_000
BEGIN = HERE / "first_picture.js"
MORE = HERE / "all_icons_and_styles.js"
COMPILED = """<style type="text/tailwindcss">
@custom-variant dark (&:where(body.body--dark, body.body--dark *));
</style>"""
"""What the compiler is told, as in NiceGUI's own pages."""


def serve() -> str:
    """Serve the file, which browsers keep, and return its path on the server."""
    digest = hashlib.sha256(STYLE.read_bytes()).hexdigest()[:16]
    path = f"/first-paint/{digest}/{STYLE.name}"
    return app.add_static_file(local_file=STYLE, url_path=path, max_cache_age=YEAR_S)


def are_ours(classes: Iterable[type]) -> bool:
    """Return whether classes of panels come with Robbie, so that `STYLE` has all that they use."""
    return all(one.__module__.partition(".")[0] in OUR_PACKAGES for one in classes)


def head(prefix: str, style: str, *, is_all: bool) -> str:
    """Return what the head of a page needs.

    Args:
        prefix: the path below which the page is served.
        style: the path of the file, from `serve`.
        is_all: whether the file has all that the page uses.
    """
    root = json.dumps(f"{prefix}/_nicegui/{nicegui.__version__}/static")
    parts = [f'<link rel="stylesheet" href="{prefix}{style}">', f"<script>{BEGIN.read_text()}</script>"]
    if not is_all:
        parts += [COMPILED, f"<script>{MORE.read_text().replace('ROOT', root)}</script>"]
    return "".join(parts)
