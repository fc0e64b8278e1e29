"""Measures the times from a press of the emergency stop to its effects, and the return of a killed server."""

import random
import signal
import time
from dataclasses import dataclass, field

from playwright.sync_api import Browser

from tools.operator.stops.scene import Scene

NOTE_PRESSES = """addEventListener("pointerdown", (event) => {
  window.age_ms = performance.now() - event.timeStamp;
  window.pressed_ms = Date.now() - window.age_ms;
}, true)"""
"""Records when the browser received the last press, and how much later the page's script received it."""
PAUSE_S = (0.05, 0.3)
"""Range of the random pause between two presses, so that they do not follow any period of the page."""


@dataclass(frozen=True)
class Presses:
    """The times from each press to its effects (s).

    Attributes:
        noticed: until the page's script received the press.
        asked: until the page server published the stop.
        stopped: until the base had a zero command.
    """

    noticed: list[float] = field(default_factory=list)
    asked: list[float] = field(default_factory=list)
    stopped: list[float] = field(default_factory=list)


def press_trials(scene: Scene, browser: Browser, count: int) -> Presses:
    """Press the emergency stop again and again."""
    chance = random.Random(count)
    found = Presses()
    with scene.page(browser, "127.0.0.1") as page:
        page.evaluate(NOTE_PRESSES)
        for _ in range(count):
            time.sleep(chance.uniform(*PAUSE_S))
            before_ns = time.monotonic_ns()
            page.click("#emergency-stop")
            wall_ahead_ns = time.time_ns() - time.monotonic_ns()
            pressed_ns = round(page.evaluate("window.pressed_ms") * 1e6) - wall_ahead_ns
            found.noticed.append(page.evaluate("window.age_ms") / 1e3)
            found.stopped.append((scene.wait_for("stopped", 1.0, before_ns) - pressed_ns) / 1e9)
            found.asked.append((scene.wait_for("asked", 1.0, before_ns) - pressed_ns) / 1e9)
            scene.stop(engaged=False)
    return found


def return_trials(scene: Scene, browser: Browser, count: int) -> list[float]:
    """Return the times (s) from the server's death until the browser showed a change made after it."""
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
