"""The report of a run says what is in its folder, whoever wrote it and however the run has ended."""

import base64
import dataclasses
import json
import math
import re
import tracemalloc
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import EpsImagePlugin
from PIL import Image as PillowImage

from robbie_mp import Header
from robbie_mp.attached.views.series import PlotSeries
from robbie_mp.cli.program import run_command
from robbie_mp.logs.report import NoResults, choose_results, read_run, report_of, seen
from robbie_mp.logs.report.charts import curve
from robbie_mp.logs.report.elements import element
from robbie_mp.logs.report.failures import failures_of
from robbie_mp.logs.report.pictures import MAX_BYTES, Pictures
from robbie_mp.logs.report.seen import MAX_PLACES, Seen, Way
from robbie_mp.messages import (
    BatteryState,
    EmergencyStop,
    Image,
    MapMetaData,
    Mark,
    Message,
    OccupancyGrid,
    Point,
    Pose,
    PoseStamped,
)
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_robots.modules.rescue.messages import VictimFound
from tests.logs.recording._support.logs import START_NS, LogFile
from tests.security._support.hostile import HOSTILE

START_S = START_NS / 1e9
SECOND = 1_000_000_000
HOSTILE_HTML = "<script>alert(1)</script><img src=x onerror=alert(2)>\"'&"


class Tags(HTMLParser):
    """Collects the tags of a page, and the addresses in it."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.addresses: list[str] = []
        self.events: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.add(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]
        self.events += [name for name, _ in attrs if name.startswith("on")]


def words(page: str) -> str:
    """Return the text of a page."""
    return " ".join(re.sub(r"<style>.*?</style>|<[^>]*>", " ", page, flags=re.DOTALL).split())


def book(**counts: int) -> dict[str, Any]:
    return {"type_name": "zoo/msg/A", "topic": "", **counts}


def results(folder: Path, *, name: str = "20261129T032700Z-1", exit_code: int | None = 0) -> Path:
    """Write the results of a run whose mapping has crashed and run again; without an exit code, killed."""
    run = folder / "output" / "rescue" / name
    (run / "log").mkdir(parents=True)
    remarks = [
        (0, "new → STARTING: start 1"),
        (1, "STARTING → RUNNING: ready"),
        (5, "RUNNING → BACKOFF: killed by SIGSEGV, again in 0.01 s"),
        (6, "BACKOFF → STARTING: start 2"),
        (7.5, "STARTING → RUNNING: ready"),
        (12, "RUNNING → BACKOFF: exit code 1, again in 0.02 s"),
        (13, f"BACKOFF → FAILED: {HOSTILE_HTML}"),
    ]
    entries = [remark("mapping", at_s, text) for at_s, text in remarks]
    (run / "log" / "mapping.jsonl").write_bytes(b"".join(one.to_line() for one in entries))
    if exit_code is not None:
        idle = {"name": "supervisor"}, {"name": "core", "subscriptions": [book(routed=9, delivered=9)]}
        mapping = {
            "name": "mapping",
            "state": "FAILED",
            "cpu_s": 2.5,
            "published": 4,
            "subscriptions": [book(routed=10, delivered=5, replaced=1, dropped=3, left=1, lost=1)],
        }
        summary = {
            "profile": "rescue",
            "exit_code": exit_code,
            "reason": "SIGTERM",
            "duration_s": 20.0,
            "modules": [idle[0], mapping, idle[1]],
        }
        (run / "summary.json").write_text(json.dumps(summary))
    return run


def remark(module: str, at_s: float, text: str) -> Entry:
    number = round((START_S + at_s) * 1e6)
    return Entry(number, START_S + at_s, Kind.SYSTEM, module, 1, "supervisor", text)


def with_log(run: Path, text: str = "it hit the table") -> None:
    """Record a drive of 3 m along a map, with a victim, a mark, and an emergency stop."""
    path = run / "recorded.mcap"
    entry = Entry(1, START_S, Kind.INFO, "logger", 1, "log", f"recording into {path}")
    (run / "log" / "logger.jsonl").write_bytes(entry.to_line())
    view = np.zeros(12, np.uint8)
    with LogFile(path) as log:
        for at_s in range(4):
            time_ns = START_NS + at_s * SECOND
            pose = Pose(position=Point(x=float(at_s), y=0.5))
            log.add(PoseStamped(pose=pose), "map_pose", time_ns=time_ns)
            log.add(BatteryState(percentage=0.9 - at_s / 10, voltage=16.0), "battery", time_ns=time_ns)
            log.add(EmergencyStop(engaged=at_s > 1), "emergency_stop_state", time_ns=time_ns)
        info = MapMetaData(resolution=0.5, width=8, height=4)
        log.add(OccupancyGrid(info=info, data=np.zeros(32, np.int8)), time_ns=START_NS + SECOND)
        image = Image(height=2, width=2, encoding="rgb8", step=6, data=view)
        victim = VictimFound(
            header=Header(), id=3, name=text, pose=Pose(position=Point(x=2.0)), state=2, image=image
        )
        log.add(victim, sender="victims", time_ns=START_NS + 2 * SECOND)
        log.add(Mark(text=text), time_ns=START_NS + 3 * SECOND)


def page_of(run: Path) -> str:
    return report_of(read_run(run, None), now_s=START_S + 100)


def test_report_of_a_recorded_run_has_map_path_findings_and_figures(tmp_path: Path) -> None:
    run = results(tmp_path)
    with_log(run)
    page = page_of(run)
    said = words(page)
    assert "rescue ended in order" in said
    assert "3.0 m travelled" in said and "60 % battery at the end" in said
    assert "Victim it hit the table" in said and "at 2.00, 0.00 m, first seen at 0:02" in said
    assert "the emergency stop was engaged" in said and "it hit the table" in said
    assert page.count("data:image/png") == 1 and page.count("data:image/jpeg") == 1
    assert "Every message is accounted for: 10 = 5 + 1 + 2 + 1 + 1 + 0" in said


def test_report_needs_no_network_and_runs_nothing(tmp_path: Path) -> None:
    run = results(tmp_path)
    with_log(run, HOSTILE_HTML + HOSTILE)
    (run / f"{HOSTILE_HTML.replace('/', '')}.txt").touch()
    page = page_of(run)
    tags = Tags(page)
    assert not tags.names & {"script", "iframe", "object", "form", "base"}
    assert not tags.events
    assert all(address.startswith("data:") for address in tags.addresses)
    assert "&lt;script&gt;alert(1)" in page
    assert "\x1b" not in page


def test_what_failed_says_how_long_it_took_to_recover(tmp_path: Path) -> None:
    first, second = failures_of(read_run(results(tmp_path), None).remarks)
    assert (first.module, first.reason) == ("mapping", "killed by SIGSEGV")
    assert first.took_s == pytest.approx(2.5)
    assert (second.took_s, second.outcome, second.times) == (None, "FAILED", 1)


def test_killed_run_has_a_report_that_says_what_is_lost(tmp_path: Path) -> None:
    said = words(page_of(results(tmp_path, exit_code=None)))
    assert "was killed" in said and "The figures of its modules are lost" in said
    assert "No messages were recorded" in said and "2.5s" in said


def test_books_that_do_not_add_up_are_told(tmp_path: Path) -> None:
    run = results(tmp_path)
    summary = json.loads((run / "summary.json").read_text())
    summary["modules"][1]["subscriptions"][0]["routed"] = 11
    (run / "summary.json").write_text(json.dumps(summary))
    assert "11 messages were sent to modules, and 10 are accounted for." in words(page_of(run))


@pytest.mark.parametrize("content", [b"", b"{", b'{"modules": 3}', b"\xff" * 100])
def test_damaged_summary_is_noted_and_the_rest_reported(tmp_path: Path, content: bytes) -> None:
    run = results(tmp_path)
    (run / "summary.json").write_bytes(content)
    said = words(page_of(run))
    assert "summary.json cannot be read" in said and "killed by SIGSEGV" in said


def test_damaged_recording_is_noted_and_the_rest_reported(tmp_path: Path) -> None:
    run = results(tmp_path)
    with_log(run)
    (run / "recorded.mcap").write_bytes(b"nothing")
    said = words(page_of(run))
    assert "A recording cannot be read" in said and "killed by SIGSEGV" in said


def test_pictures_are_bounded_and_those_left_out_are_counted() -> None:
    pictures = Pictures()
    pictures.size = MAX_BYTES
    image = Image(height=2, width=2, encoding="rgb8", step=6, data=np.zeros(12, np.uint8))
    assert pictures.of_message(image) == ""
    assert pictures.of_message(Image(encoding="no such", data=np.zeros(3, np.uint8))) == ""
    assert sum(pictures.left_out.values()) == 2


def recorded(run: Path, *messages: Message) -> str:
    """Return the report of a run that has recorded these messages."""
    path = run / "recorded.mcap"
    entry = Entry(1, START_S, Kind.INFO, "logger", 1, "log", f"recording into {path}")
    (run / "log" / "logger.jsonl").write_bytes(entry.to_line())
    with LogFile(path) as log:
        for number, message in enumerate(messages):
            topic = "map_pose" if isinstance(message, PoseStamped) else ""
            log.add(message, topic, time_ns=START_NS + number * SECOND)
    return page_of(run)


def test_long_way_and_large_map_are_drawn_whole(tmp_path: Path) -> None:
    way = [PoseStamped(pose=Pose(position=Point(x=one / 10))) for one in range(500)]
    cells = np.random.default_rng(1).integers(0, 100, 200 * 200).astype(np.int8)
    grid = OccupancyGrid(info=MapMetaData(resolution=0.5, width=200, height=200), data=cells)
    page = recorded(results(tmp_path), *way, grid)
    points = re.search(r'points="([^"]*)" class="way"', page)
    image = re.search(r'<image href="data:image/png;base64,([^"]*)"', page)
    assert points and image
    assert len(points[1].split()) == 500
    assert base64.b64decode(image[1], validate=True).endswith(b"IEND\xaeB`\x82")


@pytest.mark.parametrize("far_m", [math.nan, math.inf, 1e308])
def test_places_that_are_none_are_counted_and_not_drawn(tmp_path: Path, far_m: float) -> None:
    image = Image(height=2, width=2, encoding="rgb8", step=6, data=np.zeros(12, np.uint8))
    poses = [Pose(position=Point(x=one)) for one in (0.0, far_m, -far_m)]
    ways = [PoseStamped(pose=pose) for pose in poses]
    found = [VictimFound(id=number, pose=pose, image=image) for number, pose in enumerate(poses)]
    said = words(recorded(results(tmp_path), *ways, *found))
    assert "1 found" in said and "2 messages could not be read." in said


def test_times_that_are_none_are_left_out(tmp_path: Path) -> None:
    run = results(tmp_path, exit_code=None)
    with (run / "log" / "mapping.jsonl").open("ab") as file:
        for time_s in (math.inf, math.nan, -1.0, 1e300):
            file.write(dataclasses.replace(remark("late", 14, "new → FAILED: x"), time_s=time_s).to_line())
    page = page_of(run)
    assert "late" not in words(page) and len(page) < 100_000


def test_large_map_and_many_images_need_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    side = 3000
    grid = OccupancyGrid(
        info=MapMetaData(resolution=0.05, width=side, height=side), data=np.zeros(side * side, np.int8)
    )
    tracemalloc.start()
    try:
        shown = Pictures().of_map(grid)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert shown is not None and (shown.width, shown.height) == (side, side)
    assert peak < 6 * side * side

    monkeypatch.setattr(seen, "MAX_IMAGE_BYTES", 30)
    looked = Seen()
    image = Image(height=2, width=2, encoding="rgb8", step=6, data=np.zeros(12, np.uint8))
    kept = [looked._kept_image(None, image) for _ in range(4)]
    assert (sum(one is not None for one in kept), looked.images_left_out) == (2, 2)


def test_pictures_of_formats_that_start_programs_are_not_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[object] = []
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *what: started.append(what))
    path = tmp_path / "map.png"
    PillowImage.new("RGB", (4, 4)).save(path, "EPS")
    pictures = Pictures()
    assert pictures.of_file(path) == ""
    assert pictures.left_out == {"they are damaged, or of an unknown format": 1}
    assert not started


def test_long_way_is_thinned_out_and_keeps_its_length() -> None:
    way = Way()
    for number in range(20 * MAX_PLACES):
        way.add(float(number), number / 10, 0.0, begins=False)
    assert len(way.places) <= MAX_PLACES
    assert way.travelled_m == pytest.approx(2 * MAX_PLACES, rel=0.01)
    assert not way.breaks


def test_long_curves_are_drawn_whole() -> None:
    series = PlotSeries("charge")
    for number in range(5000):
        series.add(float(number), number % 100)
    (points,) = re.findall('points="([^"]*)"', curve(series, 0.0, 5000.0, "%", 0.0, 100.0))
    assert 400 < len(points.split()) <= 1000
    assert all(len([float(number) for number in point.split(",")]) == 2 for point in points.split())


def test_texts_and_attributes_are_escaped() -> None:
    made = element("a", "<b>", title='"><script>')
    assert made == '<a title="&quot;&gt;&lt;script&gt;">&lt;b&gt;</a>'


def test_newest_run_of_a_profile_is_meant_and_what_is_not_there_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results(tmp_path, name="20261129T032700Z-1")
    newest = results(tmp_path, name="20261129T042700Z-1")
    monkeypatch.chdir(tmp_path)
    assert choose_results("rescue")[0] == newest
    assert choose_results(None)[0] == newest
    with pytest.raises(NoResults, match="there are no results of 'demo' in output"):
        choose_results("demo")
    assert run_command(["report", "rescue"]) == 0
    assert (newest / "report.html").stat().st_mode & 0o777 == 0o600
    assert run_command(["report", "nobody"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "name the folder of a run" in line
