"""The list of what happened: clips play on the page, while the robot can be stopped, and come home."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import Page

from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import Mark
from robbie_mp.station.past.player import FOLDER
from tests._support.robot import Robot, kill, wait_until
from tests.station._support.browser import (
    IS_CONNECTED,
    browser,
    needs_chromium,
    open_panel,
    page_of,
    press_until,
    release,
)
from tests.station.test_page import address_of

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(600)]
HERE = Path(__file__).parent
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings: {port: 0, tabs: {happened: "", drive: "", map: ""}}
  base: {class: "zoo.deaf_base:DeafBase"}
black_box: {before_s: 4, after_s: 0}
"""
TEXT = "it hit <b>the</b> table"
ROW = ".happened-row[data-kind=mark]"
STATE = "#emergency-stop-state"
LEAVING = (
    "WebSocket connection to",
    "WebSocket is already in CLOSING or CLOSED state",
    "Failed to load resource",
)


def test_clip_plays_on_the_page_while_the_robot_can_be_stopped(robot: Robot, tmp_path: Path) -> None:
    (robot.folder / "zoo" / "deaf_base.py").write_text((HERE / "_support" / "deaf_base.py").read_text())
    robot.write_profile(PROFILE, has_black_box=True)
    robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address, may_say=LEAVING) as page:
        page.wait_for_selector(f"{STATE}:text-is('ready')")
        assert robot.command("mark", TEXT).returncode == 0
        open_panel(page, "happened")
        page.wait_for_selector(f"{ROW}:has-text('{TEXT}')")
        files_come_home(page, tmp_path)
        plays_the_past(page)
        page.focus("#emergency-stop")
        page.keyboard.press(" ")  # else it pauses the clip
        page.wait_for_selector(f"{STATE}:text-is('STOPPED')")
        page.click("#back-to-live")
        page.wait_for_selector("#past", state="detached")
        page.wait_for_selector(f"{STATE}:text-is('STOPPED')")
        release(page)
        killed_station_leaves_no_playback(robot, page)


def files_come_home(page: Page, folder: Path) -> None:
    """Download the clip as one log, and the report."""
    with page.expect_download() as clip:
        page.click(f"{ROW} a")
    clip.value.save_as(folder / "clip.mcap")
    with open_log(folder / "clip.mcap") as log:
        marks = [one for one in log.channels if one.type_name == Mark.type_name]
        assert [Mark.decode(one.data).text for one in log.messages(channels=marks)] == [TEXT]
    with page.expect_download() as report:
        page.click("#report")
    report.value.save_as(folder / "report.html")
    said = (folder / "report.html").read_text()
    assert "it hit &lt;b&gt;the&lt;/b&gt; table" in said and "<b>the</b>" not in said


def plays_the_past(page: Page) -> None:
    """Open the clip; nobody can order anything there."""
    page.wait_for_function(IS_CONNECTED)
    press_until(page, f"{ROW} button", "#happened-note:has-text('opening'), #past")
    page.wait_for_selector(f"#past:has-text('THE PAST'):has-text('{TEXT}')", timeout=120_000)
    page.wait_for_selector("#playback-text:has-text('PLAYBACK')")
    page.wait_for_selector(f"{STATE}:text-is('ready')")
    assert not page.query_selector("#control-bar, #mark, #drive-pad, #release-emergency-stop")


def players(robot: Robot) -> list[int]:
    """Return the processes that play a clip of this robot."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if re.search(rf"play {re.escape(str(robot.output))}/clips/", command):
            found.append(int(path.parent.name))
    return found


def killed_station_leaves_no_playback(robot: Robot, page: Page) -> None:
    open_panel(page, "happened")
    plays_the_past(page)
    assert players(robot)
    kill(robot.top()["operator"]["pid"])
    wait_until(lambda: not players(robot))
    robot.until(lambda top: top["operator"]["restarts"] == 1 and top["operator"]["state"] == "RUNNING")
    assert not (robot.known_run().folder / FOLDER).exists()  # the next station has removed what was left
