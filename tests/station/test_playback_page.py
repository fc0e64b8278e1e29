"""In a real browser, a page beside a log that plays shows the log's time and trace, and nothing live."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page

from robbie_mp import Header, Message, Time
from robbie_mp.messages import (
    BatteryState,
    EmergencyStop,
    Image,
    MapMetaData,
    OccupancyGrid,
    Odometry,
    Pose,
    PoseStamped,
)
from robbie_mp.messages import Point as Place
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from tests._support.robot import Robot
from tests.logs.recording._support.logs import START_NS, LogFile
from tests.station._support.browser import browser, needs_chromium, page_of
from tests.station.test_page import address_of

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.timeout(240)]
PROFILE = """
clock: {source: playback}
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {port: 0, tabs: {map: "", camera: "", drive: "", trace: ""}}
  playback: {class: "robbie_mp.logs.playback.module:Playback", settings: {file: old/way.mcap, rate: 1.0}}
"""
LONG_S = 120
STOPS_LIVING = ("#control-bar", "#drive-pad", "#mark", "#map-mode", "#map-cancel", "#map-draw", "#hud-slowed")
LOOKS_DEAD = (
    ".is-silent",
    ".grayscale",
    ".is-old",
    ".is-late",
    "[data-age]",
    ".state-chip.is-alert",
    ":text('silent')",
)
TIMES = """() => [...document.querySelectorAll(".tile-head")].filter((one) => one.offsetParent)
  .map((one) => getComputedStyle(one, "::after").content)"""


def messages_of(second: float) -> Iterator[tuple[Message, str]]:
    """What a robot that drives ahead publishes."""
    header = Header(stamp=Time.from_nanoseconds(START_NS + round(second * 1e9)), frame_id="map")
    at = Pose(position=Place(x=second / 10))
    yield PoseStamped(header=header, pose=at), "map_pose"
    yield Odometry(header=header), "odom"
    yield EmergencyStop(header=header), "emergency_stop_state"
    yield BatteryState(header=header, percentage=0.8, voltage=12.0), ""
    yield (
        Image(header=header, height=2, width=2, encoding="mono8", step=2, data=np.full(4, 99, np.uint8)),
        "camera",
    )
    info = MapMetaData(resolution=0.5, width=8, height=4)
    yield OccupancyGrid(header=header, info=info, data=np.zeros(32, np.int8)), ""


def write_log(folder: Path) -> None:
    """Write a log, and the trace of its run beside it, as a logger does."""
    (folder / "log").mkdir(parents=True)
    with LogFile(folder / "way.mcap") as log:
        for tenth in range(10 * LONG_S):
            for message, topic in messages_of(tenth / 10):
                log.add(message, topic, time_ns=START_NS + tenth * 100_000_000)
    said = {1: "the laser turns", 3: "the laser stands", 90: "the laser burns"}
    lines = [
        Entry(at, START_NS / 1e9 + at, Kind.WARNING, "laser", 1, "log", text).to_line()
        for at, text in said.items()
    ]
    (folder / "log" / "laser.jsonl").write_bytes(b"".join(lines))


def test_page_beside_a_log_shows_the_logs_time_and_trace_and_nothing_live(robot: Robot) -> None:
    write_log(robot.folder / "old")
    robot.write_profile(PROFILE)
    robot.start()
    with browser() as started, page_of(started, address_of(robot)) as page:
        page.wait_for_selector("#past:has-text('A LOG'):has-text('way.mcap')")
        page.wait_for_selector("#layouts:has-text('Playback')")
        paused_log_is_no_dead_robot(page)
        trace_is_the_logs(page)
        keys_change_speed_and_place(page)
        bookmark_is_kept_beside_the_log(page, robot.folder / "old" / "way.mcap.bookmarks.json")
        time_line_is_enlarged(page)


def paused_log_is_no_dead_robot(page: Page) -> None:
    page.wait_for_selector("#trace-log :text('the laser stands')")
    page.wait_for_selector(".camera-picture .picture-age")
    page.keyboard.press("k")
    page.wait_for_selector("#playback-clock:has-text('2023-11-14 22:13:2'):has-text('UTC')")
    page.wait_for_selector("#playback-text:has-text('paused')")
    page.wait_for_timeout(3500)  # a live robot that says nothing for so long is dead
    dead = [
        (what, page.locator(what).first.inner_text()) for what in LOOKS_DEAD if page.locator(what).count()
    ]
    assert not dead
    page.wait_for_selector("#emergency-stop-state:text-is('log: ready')")
    live = [
        what for what in STOPS_LIVING if page.locator(what).count() and page.locator(what).first.is_visible()
    ]
    assert not live
    times = page.evaluate(TIMES)
    assert len(times) >= 3
    assert all("22:13:2" in time and "paused" in time for time in times), times


def trace_is_the_logs(page: Page) -> None:
    lines = page.inner_text("#trace-log").split("\n")
    assert [line.split("warning ")[1] for line in lines] == ["the laser turns", "the laser stands"]
    page.click("#trace-of >> text=This run")
    page.wait_for_selector("#trace-log :text('operator station: http')")
    page.click("#trace-of >> text=The log")
    page.wait_for_selector("#trace-log :text('operator station: http')", state="detached")


def keys_change_speed_and_place(page: Page) -> None:
    page.keyboard.press("+")
    page.wait_for_selector("#playback-text:has-text('rate 2')")
    page.keyboard.press("-")
    page.keyboard.press("-")
    page.wait_for_selector("#playback-text:has-text('rate 0.5')")
    while not page.is_visible("#playback-clock:has-text('22:13:20.0')"):  # a busy machine was paused later
        page.keyboard.press("ArrowLeft")
        page.wait_for_timeout(1000)
    page.wait_for_selector("#trace-log :text('the laser')", state="detached")
    page.keyboard.press("ArrowRight")
    page.wait_for_selector("#playback-clock:has-text('22:13:25.0')")
    page.wait_for_selector("#trace-log :text('the laser stands')")
    page.focus("#playback-zoom-in")
    page.keyboard.press(" ")  # presses the button that has the focus, and does not start the log
    page.wait_for_selector("#playback-shown:has-text('of 1:59')")
    assert "paused" in page.inner_text("#playback-text")
    page.click("#playback-zoom-all")
    page.wait_for_selector("#playback-shown", state="hidden")
    page.evaluate("document.activeElement.blur()")


def bookmark_is_kept_beside_the_log(page: Page, file: Path) -> None:
    page.keyboard.press("m")
    page.wait_for_selector("#playback-events [title^='bookmark 1']")
    page.wait_for_selector(".q-notification:has-text('bookmark 1')")
    page.click("#playback-bookmarks")
    page.fill(".q-menu input", "the corner")
    page.keyboard.press("Enter")
    page.wait_for_selector("#playback-events [title^='the corner']")
    assert [one["text"] for one in json.loads(file.read_text())] == ["the corner"]
    page.keyboard.press("Escape")
    page.wait_for_selector(".q-menu", state="detached")
    page.click("#playback-events [title^='the corner']")


def time_line_is_enlarged(page: Page) -> None:
    def shown_s() -> float:
        slider = page.locator("#playback .q-slider [role=slider], #playback .q-slider[role=slider]").first
        return float(slider.get_attribute("aria-valuemax") or 0) - float(
            slider.get_attribute("aria-valuemin") or 0
        )

    assert shown_s() == pytest.approx(LONG_S, abs=1)
    page.click("#playback-zoom-in")
    page.click("#playback-zoom-in")
    page.wait_for_selector("#playback-shown:has-text('of 1:59')")
    page.wait_for_selector("#playback-shown:has-text('0:00 to 0:29 of 1:59')")
    assert shown_s() == pytest.approx(LONG_S / 4, abs=1)
    slider = page.locator("#playback .q-slider")
    box = slider.bounding_box()
    assert box
    slider.click(position={"x": box["width"] / 2, "y": box["height"] / 2})
    page.wait_for_selector("#playback-text:has-text('paused at 1')")  # 15 s are half of 30
    page.click("#playback-zoom-all")
    page.wait_for_selector("#playback-shown", state="hidden")
