"""Measures the page over slow networks: how soon it is there, and how old and smooth its picture is.

    python -m tools.operator.video --mbit 20 5 1 0.3 --kinds jpeg h264 --seconds 20 --json FILE

A robot and a real Chromium are on two hosts of a test network (root). The robot's camera sends ten pictures
of 640 x 480 pixels a second, with a time code in each. The age of the picture is the one that the page shows;
its error is the difference to the true one, by the time code in the picture that is shown.
"""

import argparse
import itertools
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, Page
from playwright.sync_api import Error as PlaywrightError

from robbie_mp.base.linux.proc import read_usage
from tools.operator.chromium import chromium_by
from tools.operator.moving_camera import CODE_BITS, CODE_HEIGHT
from tools.operator.scene import TOKEN, Scene
from tools.robot import stopping
from tools.test_network.network import Network, NetworkConditions

CAMERA = {"moving_camera": {"class": "tools.operator.moving_camera:MovingCamera"}}
QUEUE_S = 0.3
SETTLE_S = 12.0
SHOWN = """[...document.querySelectorAll(".camera-picture :is(img, canvas)")]
  .find((one) => one.checkVisibility())"""
"""The image, or the canvas of a stream, that shows the picture to drive by."""
NAME = "localhost"
"""The browser's name for the robot: with https, or by this name, it has a video decoder."""
NO_DECODER = "delete window.VideoDecoder"
COUNT = """(() => {
  const pictures = (window.pictures = []), ages = (window.ages = []);
  let last_s = null;
  const look = () => {
    const born_s = window.picture_to_drive_by?.born_s, shown = SHOWN;
    if (born_s && born_s !== last_s && shown)
      pictures.push([performance.now(), shown.naturalWidth ?? shown.width]);
    last_s = born_s;
    requestAnimationFrame(look);
  };
  look();
  setInterval(() => {
    const text = document.querySelector(".camera-picture .picture-age")?.textContent;
    if (text) ages.push(parseFloat(text));
  }, 50);
})()""".replace("SHOWN", SHOWN)
"""Records when pictures are shown, ms, their width, and every 50 ms the age that the page shows, s."""
BEGIN = "() => { window.pictures.length = window.ages.length = 0; }"
READ = """([bits, height]) => {
  const image = SHOWN;
  const text = document.querySelector(".camera-picture .picture-age");
  if (!image || image.complete === false || !text) return null;
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [image.naturalWidth ?? image.width, image.naturalHeight ?? image.height];
  const pen = canvas.getContext("2d", { willReadFrequently: true }), edge = canvas.width / bits;
  pen.drawImage(image, 0, 0);
  const middle = ((height / 640) * canvas.width) / 2;
  const is_set = (at) => pen.getImageData((at + 0.5) * edge, middle, 1, 1).data[0] > 127;
  const taken_ms = [...Array(bits).keys()].reduce((sum, at) => sum + (is_set(at) ? 2 ** at : 0), 0);
  return [taken_ms, parseFloat(text.textContent)];
}""".replace("SHOWN", SHOWN)
"""Returns the time in the picture, ms, and the age that the page shows, s."""
SAMPLES, SAMPLE_MS = 60, 130
MAX_ASK_MS = 40.0
"""A sample whose browser took longer to answer, as on a busy machine, does not count."""
LOADED = """() => performance.getEntriesByType("resource").concat(performance.getEntriesByType("navigation"))
  .reduce((sum, one) => sum + one.transferSize, 0)"""


def measure(scene: Scene, browser: Browser, seconds: float, kind: str) -> dict[str, float]:
    """Load the page twice, and look at its picture."""
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    page = context.new_page()
    page.set_default_timeout(180_000)
    if kind == "jpeg":
        page.add_init_script(NO_DECODER)
    page.add_init_script(COUNT)  # also in a page that loads itself again
    try:
        page.goto(f"{scene.address(NAME)}login")
        page.fill("#token", TOKEN)
        first_s = until_ready(page, lambda: page.keyboard.press("Enter"))
        loaded_kb = page.evaluate(LOADED) / 1e3
        again_s = until_ready(page, page.reload)
        page.wait_for_timeout(SETTLE_S * 1e3)
        page.evaluate(BEGIN)
        begin_s, used_s = time.monotonic(), processor_s(scene)
        page.wait_for_timeout(seconds * 1e3)
        pictures, ages = page.evaluate("[window.pictures, window.ages]")
        share = (processor_s(scene) - used_s) / (time.monotonic() - begin_s)
        is_stream = page.evaluate(f"{SHOWN}?.tagName === 'CANVAS'")
        errors = [*age_errors(page)]
    finally:
        context.close()
    return {
        "first load, s": first_s,
        "first load, kB": loaded_kb,
        "load again, s": again_s,
        "station, %": 100.0 * share,
        "is a stream": float(is_stream),
        "pictures/s": len(pictures) / seconds,
        "width, pixels": float(np.median([width for _, width in pictures] or [0])),
        "age p50, s": float(np.median(ages or [np.nan])),
        "age p95, s": float(np.percentile(ages or [np.nan], 95)),
        "age max, s": float(max(ages or [np.nan])),
        "age error p50, s": float(np.median(errors or [np.nan])),
        "age error p95, s": float(np.percentile(np.abs(errors or [np.nan]), 95)),
        "age samples": float(len(errors)),
    }


def processor_s(scene: Scene) -> float:
    """Return the processor time that the station has used so far."""
    return read_usage(scene.pid("operator")).cpu_s


def age_errors(page: Page) -> Iterator[float]:
    """Yield how much larger than the true age of the picture the one is that the page shows, s."""
    for _ in range(SAMPLES):
        page.wait_for_timeout(SAMPLE_MS)  # to meet pictures of all ages
        asked_ms = time.monotonic_ns() / 1e6
        try:
            found = page.evaluate(READ, [CODE_BITS, CODE_HEIGHT])
        except PlaywrightError:
            continue  # the page loads itself again
        answered_ms = time.monotonic_ns() / 1e6
        if found is not None and answered_ms - asked_ms < MAX_ASK_MS:
            now_ms = (asked_ms + answered_ms) / 2
            yield found[1] - (now_ms - found[0]) % (1 << CODE_BITS) / 1e3


def until_ready(page: Page, load: Any) -> float:
    """Return the time (s) until a page has its emergency stop and a picture."""
    begin_s = time.monotonic()
    load()
    page.wait_for_selector("#emergency-stop-state:has-text('ready')")
    page.wait_for_selector(".camera-picture .picture-age")
    return time.monotonic() - begin_s


def conditions(mbit: float, round_trip_ms: float) -> NetworkConditions:
    """Return a network of a limited rate, in Mbit/s."""
    return NetworkConditions(bandwidth_bit_per_s=mbit * 1e6, queue_s=QUEUE_S, delay_s=round_trip_ms / 2e3)


@contextmanager
def stage(folder: Path) -> Iterator[tuple[Network, Scene, Browser]]:
    """Start a robot on one host, and a browser on the other one."""
    with ExitStack() as stack:
        network = stack.enter_context(Network("robot", "laptop"))
        scene = Scene(folder / "page", None, CAMERA, on_host=network.host("robot").command())
        stack.enter_context(stopping(scene.robot))
        scene.begin()
        laptop = network.host("laptop").command()
        rules = f"--host-resolver-rules=MAP {NAME} {network.host('robot').address}"
        browser = stack.enter_context(chromium_by(laptop, folder, rules))
        yield network, scene, browser


def main(arguments: Sequence[str]) -> None:
    """Measure at each rate, and print a line of figures for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--mbit", type=float, nargs="+", default=[20.0, 5.0, 1.0, 0.3])
    parser.add_argument("--kinds", nargs="+", choices=["jpeg", "h264"], default=["jpeg", "h264"])
    parser.add_argument("--round-trip-ms", type=float, default=80.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args(arguments)
    found = {}
    with tempfile.TemporaryDirectory() as folder, stage(Path(folder)) as (network, scene, browser):
        for mbit, kind in itertools.product(chosen.mbit, chosen.kinds):
            network.set(conditions(mbit, chosen.round_trip_ms))
            figures = measure(scene, browser, chosen.seconds, kind)
            found[f"{mbit} {kind}"] = figures
            rounded = {name: round(value, 2) for name, value in figures.items()}
            print(f"{mbit} Mbit/s, {kind}:", rounded, flush=True)
    if chosen.json:
        chosen.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main(sys.argv[1:])
