"""Pages in a real Chromium: `python -m tools.load.operator.browser_pages [--elsewhere] ADDRESS ROLE/TAB …`.

The tab `tiles` is the layout `Live` with several panels at once. With `--elsewhere` the browser takes only
the processor time that the robot leaves, as if it ran on another machine.

The program prints `ready` when all pages show their tabs. It answers a line `count` with the number of times
that each page has been drawn so far. It answers a line `drag` with the rate at which each page is drawn while
a mouse drags and zooms in it. The answers are JSON. The program ends when its input ends.
"""

import contextlib
import json
import logging
import sys
import time
from pathlib import Path
from typing import Any

import psutil
from playwright.sync_api import Page

from robbie_mp.base.linux.priority import lower_priority
from tools.load.operator import HIDDEN, LIVE, NICE, TILES, token_of
from tools.operator.stops.chromium import chromium

LOAD_LIMIT_MS = 180_000
COUNT_IMAGES = """document.addEventListener("load", (event) => { // the window never hears of an image
  if (event.target.classList?.contains("newest-image")) window.images = (window.images ?? 0) + 1;
}, true);
const watch = () => {
  for (const name of ["system", "trace"]) {
    const panel = document.getElementById(`panel-${name}`);
    if (!panel || panel.is_watched) continue;
    panel.is_watched = true;
    const note = () => (window[name] = (window[name] ?? 0) + 1);
    new MutationObserver(note).observe(panel, { subtree: true, childList: true, characterData: true });
  }
};
setInterval(watch, 300)"""
COUNTS = """() => {
  const updates = (name) => Number(document.getElementById(name)?.dataset.updates ?? 0);
  const scene = Object.values(mounted_app.$refs).find((one) => one?.renderer);
  return { view: updates("view-moving"), map: updates("map-view"), cameras: window.images ?? 0,
    frames: scene?.renderer.info.render.frame ?? 0, system: window.system ?? 0, trace: window.trace ?? 0 };
}"""
CANVASES = {"map": "#map-view", "view": "#view-scene canvas"}
DRAG_S = 10.0
ELSEWHERE = "--elsewhere"
COUNT_FRAMES = """() => {
  window.drawn = 0;
  const count = () => { window.drawn += 1; requestAnimationFrame(count); };
  requestAnimationFrame(count);
}"""


def open_page(page: Page, address: str, role: str, tab: str) -> None:
    """Log in, load the page, and turn to a tab."""
    page.set_default_timeout(LOAD_LIMIT_MS)
    page.add_init_script(COUNT_IMAGES)
    page.goto(address, wait_until="commit")
    page.fill("#token", token_of(role))
    page.press("#token", "Enter")
    if tab in (TILES, HIDDEN):
        page.wait_for_selector("#layouts")
        page.goto(f"{address}?layout={LIVE}", wait_until="commit")
        page.wait_for_selector("#map-view")
        page.wait_for_function(f"() => {{ const now = ({COUNTS})(); return now.view > 0 && now.map > 0; }}")
        if tab == HIDDEN:
            page.click("#tab-parameters")
            page.wait_for_selector("#map-view", state="hidden")
        return
    page.wait_for_selector(f"#tab-{tab}")
    page.goto(f"{address}?tab={tab}", wait_until="commit")  # while fonts load, a click may miss the tab
    page.wait_for_function(
        f"() => ({COUNTS})()['{tab}'] > 0" if tab in ("view", "map", "cameras") else "true"
    )


def drag(page: Page, tab: str) -> dict[str, float]:
    """Drag and zoom for a while. Return how often per second the page and the scene were drawn meanwhile."""
    canvas = page.locator(CANVASES[tab])
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.evaluate(COUNT_FRAMES)
    page.mouse.move(x, y)
    page.mouse.down()
    scene, began_s, steps = page.evaluate(COUNTS)["frames"], time.monotonic(), 0
    while time.monotonic() - began_s < DRAG_S:
        steps += 1
        page.mouse.move(x + 100 * (steps % 2), y + 50 * (steps % 3))
        if steps % 20 == 0:
            page.mouse.wheel(0, -100 if steps % 40 else 100)
    took_s = time.monotonic() - began_s
    page.mouse.up()
    frames = page.evaluate("window.drawn")
    return {"page": frames / took_s, "scene": (page.evaluate(COUNTS)["frames"] - scene) / took_s}


def lower_sessions() -> None:
    """Lower the priority of the sessions of all processes that this one has started.

    Chromium has a session of its own, among which Linux first shares the processors, see `lower_priority`.
    """
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(OSError):  # it has ended, or the kernel has no such groups
            Path(f"/proc/{process.pid}/autogroup").write_text(str(NICE))


def main(address: str, visits: list[str], *, is_elsewhere: bool) -> None:
    """Open the pages, and answer requests until the input ends."""
    if is_elsewhere:
        lower_priority(NICE, logging.getLogger())
    with chromium() as browser:
        if is_elsewhere:
            lower_sessions()
        pages: list[tuple[Page, str]] = []
        for visit in visits:
            role, tab = visit.split("/")
            page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
            open_page(page, address, role, tab)
            pages.append((page, tab))
        print("ready", flush=True)
        for line in sys.stdin:
            is_drag = line.strip() == "drag"
            found: list[dict[str, Any]] = [
                drag(page, tab) if is_drag else page.evaluate(COUNTS) for page, tab in pages
            ]
            print(json.dumps(found), flush=True)


if __name__ == "__main__":
    given = [one for one in sys.argv[1:] if one != ELSEWHERE]
    main(given[0], given[1:], is_elsewhere=ELSEWHERE in sys.argv)
