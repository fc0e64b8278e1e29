"""From a press of the emergency stop to the base's zero command, from a dead server to the present state."""

import random
import signal
import time

from playwright.sync_api import Browser

from tools.operator_trials.scene import Scene

NOTE_PRESSES = """addEventListener("pointerdown", (event) => {
  window.pressed_ms = Date.now() - (performance.now() - event.timeStamp);
}, true)"""
"""When the browser got each press, before anything else hears of it."""
PAUSE_S = (0.05, 0.3)
"""Between two presses: no multiple of any period of the page."""


def press_trials(scene: Scene, browser: Browser, count: int) -> tuple[list[float], list[float]]:
    """Return how long it took for each of several presses (s) until the page server had the base asked.

    The second list is of how long it took until the base did not want to move any more.
    """
    chance = random.Random(count)
    asked, stopped = [], []
    with scene.page(browser, "127.0.0.1") as page:
        page.evaluate(NOTE_PRESSES)
        for _ in range(count):
            time.sleep(chance.uniform(*PAUSE_S))
            before_ns = time.monotonic_ns()
            page.click("#emergency-stop")
            wall_ahead_ns = time.time_ns() - time.monotonic_ns()
            pressed_ns = round(page.evaluate("window.pressed_ms") * 1e6) - wall_ahead_ns
            stopped.append((scene.wait_for("stopped", 1.0, before_ns) - pressed_ns) / 1e9)
            asked.append((scene.wait_for("asked", 1.0, before_ns) - pressed_ns) / 1e9)
            scene.stop(engaged=False)
    return asked, stopped


def return_trials(scene: Scene, browser: Browser, count: int) -> list[float]:
    """Return how long it took (s) from the death of the server until the browser showed what came after."""
    found = []
    with scene.page(browser, "127.0.0.1") as page:
        for _ in range(count):
            scene.wait_for_spare()
            at_ns = scene.send("operator", signal.SIGKILL)
            scene.stop(engaged=True)
            page.wait_for_selector("#emergency-stop-state:has-text('STOPPED')")
            found.append((time.monotonic_ns() - at_ns) / 1e9)
            scene.stop(engaged=False)
            page.wait_for_selector("#emergency-stop-state:has-text('ready')")
    return found
