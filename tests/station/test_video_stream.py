"""With https or on the robot's machine, the picture to drive by is a stream; when it fails, it is JPEG."""

import statistics
import time
from collections.abc import Iterator

import pytest
from playwright.sync_api import Page

from tests._support.robot import Robot, wait_until
from tests.station._support.browser import browser, needs_chromium, page_of
from tests.station.test_page import address_of
from tools.operator.moving_camera import CODE_BITS, CODE_HEIGHT
from tools.operator.video import NO_DECODER, READ

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(200)]
PROFILE = """
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0}}
  camera: {class: "tools.operator.moving_camera:MovingCamera"}
"""
IS_STREAM = "document.querySelector('.camera-picture canvas')?.checkVisibility()"
IS_JPEG = "document.querySelector('.camera-picture img')?.checkVisibility()"
BREAK = """(how) => {
  const decode = VideoDecoder.prototype.decode;
  window.failed_ms = null;
  VideoDecoder.prototype.decode = function (chunk) {
    window.failed_ms ??= performance.now();
    if (how === "stops") return;
    if (how === "refuses") throw new TypeError("it is tired");
    const { type, timestamp } = chunk;
    decode.call(this, new EncodedVideoChunk({ type, timestamp, data: new Uint8Array(9) }));
  };
  const look = () => {
    if (window.failed_ms && document.querySelector(".camera-picture img").checkVisibility())
      window.fallback_ms = performance.now() - window.failed_ms;
    else requestAnimationFrame(look);
  };
  window.repair = () => void (VideoDecoder.prototype.decode = decode);
  look();
}"""
"""Breaks the browser's decoder, and measures how long the page takes to show JPEG."""
OPENED = """
const Plain = window.WebSocket;
window.opened = [];
window.WebSocket = class extends Plain {
  constructor(to) {
    super(to);
    window.opened.push({ to, is_early: !document.getElementById("emergency-stop-state") });
  }
};
"""
"""Notes each connection that the page opens, and whether its elements were not there yet."""
FALLBACK_S = 1.0
SAMPLES, MAX_ERROR_S = 30, 0.1


@pytest.fixture
def page(robot: Robot) -> Iterator[Page]:
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as opened:
        opened.wait_for_function(IS_STREAM)
        yield opened


def test_stream_shows_what_the_camera_saw_and_its_true_age(page: Page) -> None:
    errors = []
    for _ in range(SAMPLES):
        page.wait_for_timeout(70)  # to meet pictures of all ages
        before_ms = time.monotonic_ns() / 1e6
        taken_ms, shown_s = page.evaluate(READ, [CODE_BITS, CODE_HEIGHT])
        now_ms = (before_ms + time.monotonic_ns() / 1e6) / 2
        errors.append(shown_s - (now_ms - taken_ms) % (1 << CODE_BITS) / 1e3)
    assert abs(statistics.median(errors)) <= MAX_ERROR_S, errors
    assert page.evaluate(IS_STREAM)


@pytest.mark.parametrize(
    ("how", "told"), [("stops", "does not answer"), ("refuses", "it is tired"), ("damages", "failed")]
)
def test_decoder_that_fails_falls_back_to_jpeg_within_a_second_and_comes_back(
    robot: Robot, page: Page, how: str, told: str
) -> None:
    page.evaluate(BREAK, how)
    page.wait_for_function("window.fallback_ms")
    assert page.evaluate("window.fallback_ms") <= 1e3 * FALLBACK_S
    page.wait_for_selector(f".camera-picture .picture-note:has-text('{told}')")
    wait_until(lambda: "video of pages failed 1 times" in robot.top()["operator"]["status"])
    page.evaluate("window.repair()")
    page.wait_for_function(IS_STREAM)
    page.wait_for_selector(".camera-picture .picture-note", state="detached")


def test_lost_picture_of_the_stream_is_not_made_up(page: Page) -> None:
    page.evaluate("""() => {
      const parse = JSON.parse;
      JSON.parse = (text) => {
        const found = parse(text);
        if (found?.video?.number > 3 && !window.skipped) window.skipped = (found.video.number += 1);
        return found;
      };
    }""")
    page.wait_for_selector(".camera-picture .picture-note:has-text('a picture of the video is missing')")
    assert page.evaluate(IS_JPEG)
    page.wait_for_function(IS_STREAM)


def test_page_without_a_decoder_shows_jpeg(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot), script=NO_DECODER) as page:
        page.wait_for_function(f"{IS_JPEG} && window.picture_to_drive_by")
        first_s = page.evaluate("window.picture_to_drive_by.born_s")
        page.wait_for_function("(first_s) => window.picture_to_drive_by.born_s > first_s + 2", arg=first_s)
        assert page.evaluate(IS_JPEG)


def test_picture_that_the_browser_cannot_decode_is_told_and_does_not_look_new(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot), script=NO_DECODER) as page:
        page.wait_for_function(f"{IS_JPEG} && window.picture_to_drive_by")
        page.evaluate("() => { window.Blob = class extends Blob { constructor() { super(['x']); } }; }")
        page.wait_for_selector(".camera-picture .no-picture:has-text('cannot decode')")
        born_s = page.evaluate("window.picture_to_drive_by.born_s")
        page.wait_for_timeout(500)
        assert page.evaluate("window.picture_to_drive_by.born_s") == born_s


def test_connection_of_the_pictures_opens_before_the_page_is_there(robot: Robot) -> None:
    robot.write_profile(PROFILE)
    robot.start()
    address = address_of(robot)
    with browser() as started:
        for _ in range(2):  # the station must know the camera before the page is made
            with page_of(started, address, script=OPENED) as page:
                page.wait_for_selector(".camera-picture .picture-age")
                opened = page.evaluate("window.opened")
        assert [one["is_early"] for one in opened if "/live/video" in one["to"]] == [True]
