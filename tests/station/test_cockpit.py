"""In a real browser, the page tells an operator who drives the robot, and how late the page is."""

import os
import signal
import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, Page

from tests._support.delaying_proxy import delaying_proxy
from tests._support.left_behind import leaving_nothing_behind
from tests._support.robot import Robot, robot_in, wait_until
from tests.station._support.browser import LAPTOP, browser, choose_layout, needs_chromium, page_of
from tests.station.test_driving import ARENA, Journal
from tests.station.test_page import address_of
from tools.operator.video import SHOWN

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(300)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator: {class: "robbie_mp.station:OperatorStation", settings: {port: 0, max_linear_m_per_s: 0.4}}
  base: {class: "robbie_robots.modules.devices.base:SimulatedBase", settings: {arena: arena.yaml}}
  cruise: {class: "zoo.cruise:Cruise"}
  witness: {class: "zoo.witness:Witness"}
  clockface: {class: "zoo.clockface:Clockface"}
  pan_tilt: {class: "robbie_robots.modules.devices.pan_tilt:SimulatedPanTiltModule"}
"""
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True}
BUTTONS = ("#go-on", "#hold", "#take-over")
MIN_TARGET_PX = 48
COVERED = """() => {
  const note = document.querySelector(".q-notification")?.getBoundingClientRect();
  const speed = document.querySelector("#camera-display").getBoundingClientRect();
  if (!note) return null;
  const is_beside = note.left >= speed.right || note.right <= speed.left;
  return !is_beside && note.top < speed.bottom && note.bottom > speed.top;
}"""
"""Whether a note covers the speed; null: there is no note."""
KEEP_AWAKE = """Object.defineProperty(navigator, "wakeLock", { value: {
  request: async (kind) => ((window.kept_on = kind), Object.assign(new EventTarget(), { release() {} })),
} })"""
READ = """() => {
  const image = SHOWN, canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [256, 32]; // on a busy machine the picture may come smaller
  const pen = canvas.getContext("2d");
  pen.drawImage(image, 0, 0, canvas.width, canvas.height);
  const bit = (at) => (pen.getImageData(16 * at + 8, 16, 1, 1).data[0] > 127 ? 1 << at : 0);
  const taken_ms = [...Array(16).keys()].reduce((sum, at) => sum + bit(at), 0);
  return [taken_ms, document.querySelector(".camera-picture .picture-age").textContent];
}""".replace("SHOWN", SHOWN)
"""Returns what time is in the picture, ms, and what the page says of its age."""
AHEAD = "[aria-label='The camera looks ahead']"
COVERING = """() => {
  const shown = ["#hud-ring", "#hud-look", "#camera-light"].map((one) => document.querySelector(one));
  const seen = shown.filter((one) => one?.checkVisibility());
  const [ring, ...others] = seen.map((one) => one.getBoundingClientRect());
  return others.filter((one) =>
    one.left < ring.right && one.right > ring.left && one.top < ring.bottom && one.bottom > ring.top).length;
}"""
"""How many others the ring of free distances covers."""
TILE_SIZES = ((1280, 800), (760, 420), (520, 360), (430, 330), (390, 300))
SAMPLES, MAX_ERROR_S = 15, 0.1


@pytest.fixture(autouse=True, scope="module")
def nothing_left_behind() -> Iterator[None]:
    """Check once, after all tests, which share a robot and a browser."""
    with leaving_nothing_behind():
        yield


@pytest.fixture(scope="module")
def started(nothing_left_behind: None) -> Iterator[Browser]:
    """The browser of all tests."""
    with browser() as one:
        yield one


@pytest.fixture(scope="module")
def cruising(nothing_left_behind: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """A robot that a module turns, with a camera and a pose."""
    with robot_in(tmp_path_factory.mktemp("cockpit")) as robot:
        for name in ("cruise", "witness", "clockface"):
            (robot.folder / "zoo" / f"{name}.py").write_text((HERE / "_support" / f"{name}.py").read_text())
        (robot.folder / "arena.yaml").write_text(ARENA)
        robot.write_profile(PROFILE)
        robot.start()
        yield robot


def is_controlled(page: Page, mode: str, who: str) -> None:
    """Wait until the bar says so."""
    page.wait_for_selector(f"#control-mode:has-text('{mode}')")
    page.wait_for_selector(f"#control-who:text-is('{who}')")


def test_drive_key_takes_over_letting_go_holds_and_only_g_goes_on(cruising: Robot, started: Browser) -> None:
    journal = Journal(cruising)
    with page_of(started, address_of(cruising)) as page:
        is_controlled(page, "AUTO", "modules drive")
        page.keyboard.down("KeyW")
        is_controlled(page, "MANUAL", "you drive")
        wait_until(lambda: journal.speed() > 0.1)
        page.keyboard.up("KeyW")
        is_controlled(page, "HOLD", "nobody drives")
        page.wait_for_selector("#control-why:has-text('the operator has let go')")
        assert page.is_disabled("#hold")
        page.keyboard.press("g")
        is_controlled(page, "AUTO", "modules drive")
        assert page.is_disabled("#go-on")


def test_bar_and_its_buttons_stay_at_their_places_in_all_layouts_and_states(
    cruising: Robot, started: Browser
) -> None:
    for device in (LAPTOP, PHONE):
        with page_of(started, address_of(cruising), device) as page:
            page.add_init_script(KEEP_AWAKE)
            page.reload()
            page.wait_for_function("window.kept_on === 'screen'")
            places = places_of(page)
            page.click("#hold")
            note = page.wait_for_function(f"() => [({COVERED})()].find((it) => it !== null)?.toString()")
            assert note.json_value() == "false"  # at once: on a busy machine it may have gone later
            is_controlled(page, "HOLD", "nobody drives")
            for number, name in enumerate(("Drive", "Mission", "Engineer", "Tablet"), 1):
                choose_layout(page, number, name)
                assert places_of(page) == places
                assert device is LAPTOP or not page.is_visible(".drive-hint")  # it would be cut off
            page.click("#go-on")  # not at once: what is ordered half a second after Hold is refused
            is_controlled(page, "AUTO", "modules drive")
            assert places_of(page) == places


def places_of(page: Page) -> list[tuple[float, ...]]:
    """Where bar and buttons are; each can be touched."""
    page.wait_for_selector("#control-bar #control-who:has-text('drive')")
    boxes = [page.locator(one).bounding_box() for one in ("#control-bar", "#emergency-stop", *BUTTONS)]
    assert all(box and min(box["width"], box["height"]) >= MIN_TARGET_PX for box in boxes)
    return [(box["x"], box["y"], box["width"], box["height"]) for box in boxes if box]


def test_bar_shows_the_age_of_the_pages_own_link(cruising: Robot, started: Browser) -> None:
    with page_of(started, address_of(cruising), may_say=("WebSocket",)) as page:
        page.wait_for_selector("#control-link:not(.is-late):has-text('ms')")
        pid = int(cruising.top()["operator"]["pid"])
        os.kill(pid, signal.SIGSTOP)
        try:
            page.wait_for_selector("#control-link.is-late:text-matches('[1-9][.][0-9] s')")
        finally:
            os.kill(pid, signal.SIGCONT)
        page.wait_for_selector("#control-link:not(.is-late):has-text('ms')")


@pytest.mark.parametrize(("delay_s", "look"), [(0.0, ""), (0.04, ""), (0.3, "is-old")])
def test_age_of_the_picture_is_the_true_one_over_any_network(
    cruising: Robot, started: Browser, delay_s: float, look: str
) -> None:
    address = urlsplit(address_of(cruising))
    with delaying_proxy(address.port or 0, delay_s) as proxy:
        near = address._replace(netloc=f"127.0.0.1:{proxy.port}").geturl()
        with page_of(started, near, may_say=("",)) as page:
            page.wait_for_selector(f".camera-picture .picture-age{f'.{look}' if look else ''}")
            errors = []
            for _ in range(SAMPLES):
                page.wait_for_timeout(70)  # to meet pictures of all ages
                taken_ms, shown = page.evaluate(READ)
                true_s = (time.monotonic_ns() // 1_000_000 - taken_ms) % (1 << 16) / 1000
                errors.append(float(shown.split()[0]) - true_s)
    assert abs(statistics.median(errors)) <= MAX_ERROR_S, errors


def test_old_picture_and_pose_are_grey_and_the_robot_drives_slowly(cruising: Robot, started: Browser) -> None:
    with page_of(started, address_of(cruising)) as page:
        page.wait_for_selector(".map-stage:not([data-age])")
        page.wait_for_selector(".camera-picture .picture-age")
        page.wait_for_selector(".camera-small .newest-image .picture-age")
        small = page.locator("#camera-small button").bounding_box()
        assert small is not None
        assert small["height"] > 10  # its picture is in sight
        pid = int(cruising.top()["clockface"]["pid"])
        os.kill(pid, signal.SIGSTOP)
        try:
            page.wait_for_selector(".camera-picture .picture-age.is-silent")
            page.wait_for_selector(".map-stage[data-age^='Position ']")
            page.wait_for_selector(".scene-moving[data-age^='Position ']")
            page.wait_for_selector("#take-over:disabled")
            page.keyboard.down("KeyW")
            page.wait_for_selector("#hud-slowed:has-text('old picture')")
            page.keyboard.up("KeyW")
            is_controlled(page, "HOLD", "nobody drives")
            page.keyboard.press("g")
            is_controlled(page, "AUTO", "modules drive")
        finally:
            os.kill(pid, signal.SIGCONT)
        page.wait_for_selector(".camera-picture .newest-image:not(.grayscale)")
        page.wait_for_selector(".map-stage:not([data-age])")
    fastest = max(row[1] for row in Journal(cruising).rows("command")[-5:])
    assert fastest <= 0.2 * 0.5 / 2.0


def test_camera_is_turned_and_centred_and_the_display_says_where_it_looks(
    cruising: Robot, started: Browser
) -> None:
    commands = len(Journal(cruising).rows("command"))
    with page_of(started, address_of(cruising)) as page:
        page.wait_for_selector("#take-over:disabled")  # when the page of the test before has been given up
        page.wait_for_selector(f"#hud-look{AHEAD}")
        page.wait_for_selector(".camera-picture .detection-boxes > div")
        page.keyboard.down("Shift")
        page.keyboard.down("ArrowLeft")
        page.wait_for_selector("#hud-look[aria-label$='° left']")
        page.wait_for_selector(".camera-picture .detection-boxes:empty", state="attached")
        page.keyboard.up("ArrowLeft")
        page.keyboard.up("Shift")
        page.wait_for_selector(".camera-picture .detection-boxes > div")  # the camera stands again
        page.keyboard.press("v")
        page.wait_for_selector(f"#hud-look{AHEAD}")
        box = page.locator(".camera-picture").bounding_box()
        assert box is not None
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 3
        page.mouse.move(*middle)
        page.mouse.down()
        page.mouse.move(middle[0] - box["width"] / 3, middle[1], steps=5)
        page.wait_for_selector("#hud-look[aria-label$='° right']")
        page.mouse.up()
        page.keyboard.press("v")
        page.wait_for_selector(f"#hud-look{AHEAD}")
        page.wait_for_selector("#control-mode:has-text('AUTO')")
    assert len(Journal(cruising).rows("command")) == commands  # the robot itself did not move by hand


def test_shift_and_an_arrow_do_not_take_the_guard_away(cruising: Robot, started: Browser) -> None:
    with page_of(started, address_of(cruising)) as page:
        page.wait_for_selector("#take-over:disabled")
        page.keyboard.down("ArrowUp")
        is_controlled(page, "MANUAL", "you drive")
        page.keyboard.down("Shift")
        page.wait_for_timeout(500)  # in which a command without the guard would have come
        assert not page.is_visible(".hud-hint:has-text('WITHOUT GUARD')")
        page.keyboard.up("ArrowUp")
        page.keyboard.up("Shift")
        is_controlled(page, "HOLD", "nobody drives")
        page.keyboard.press("g")
        is_controlled(page, "AUTO", "modules drive")


def test_ring_bumper_and_rear_picture_show_what_is_round_the_robot(cruising: Robot, started: Browser) -> None:
    with page_of(started, address_of(cruising)) as page:
        page.wait_for_selector("#take-over:disabled")  # when the page of the test before has been given up
        page.wait_for_selector(
            "#hud-ring [data-at='left'].is-close[data-m='0.8']"
        )  # half the width is not free
        page.wait_for_selector("#hud-ring [data-at='behind'][data-m='5.8']")
        assert page.locator("#hud-ring path").count() == 8
        page.wait_for_selector("#hud-bumper:has-text('front left')")
        page.wait_for_selector(".hud-name:text-is('camera')")
        page.keyboard.down("KeyS")
        page.wait_for_selector(".hud-name:text-is('rear_camera')")
        page.keyboard.up("KeyS")
        page.wait_for_selector(".hud-name:text-is('camera')")
        is_controlled(page, "HOLD", "nobody drives")
        page.keyboard.press("g")
        is_controlled(page, "AUTO", "modules drive")


def test_ring_covers_nothing_however_small_the_picture_is(cruising: Robot, started: Browser) -> None:
    with page_of(started, f"{address_of(cruising)}") as page:
        page.wait_for_selector("#state-time")
        page.goto(f"{page.url.partition('?')[0]}tile/camera")
        for width, height in TILE_SIZES:
            page.set_viewport_size({"width": width, "height": height})
            page.wait_for_selector("#hud-ring [data-at='left']")
            page.wait_for_selector("#hud-look")
            assert page.evaluate(COVERING) == 0, (width, height)
