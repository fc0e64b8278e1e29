"""Recordings and snapshots by hand: made on the page, kept in the results of the run, and downloaded."""

import io
import logging
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image as PillowImage
from playwright.sync_api import Page

from robbie_mp.attached.views.image_pixels import NoPicture
from robbie_mp.base.utc import time_from, time_text
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import CompressedImage, Image
from robbie_mp.station.past import recordings
from robbie_mp.station.past.recordings import DISK_FULL, RunRecorder, saved_recordings
from robbie_mp.station.past.snapshots import (
    EXIF_PART,
    SNAPSHOTS,
    TAKEN,
    TAKEN_FRACTION,
    name_of,
    saved_snapshots,
    stamped,
)
from tests._support.robot import Robot, wait_until
from tests.station._support.browser import IS_CONNECTED, browser, needs_chromium, open_panel, page_of
from tests.station.test_page import address_of
from tests.station.test_panels import log_in

HERE = Path(__file__).parent
LOG = logging.getLogger(__name__)
PROFILE = """
modules:
  operator:
    class: robbie_mp.station:OperatorStation
    settings:
      port: 0
      operator_token: file:operator.token
      observer_token: file:observer.token
  known: {class: "zoo.known_robot:KnownRobot"}
"""
ROW = ".happened-row[data-kind={}]"


class Usage(NamedTuple):
    free: float


@needs_chromium
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_recording_and_snapshot_are_made_on_the_page_and_come_home(robot: Robot, tmp_path: Path) -> None:
    (robot.folder / "zoo" / "known_robot.py").write_text((HERE / "_support" / "known_robot.py").read_text())
    robot.write_secret("operator.token", "opens-everything")
    robot.write_secret("observer.token", "opens-all-our-eyes")
    robot.write_profile(PROFILE)
    robot.start()
    address = address_of(robot)
    with browser() as started, page_of(started, address) as page, page_of(started, address) as other:
        log_in(page, "opens-everything")
        log_in(other, "opens-all-our-eyes")
        page.wait_for_selector("#state-time")
        page.wait_for_function(IS_CONNECTED)
        page.click("#record")
        page.wait_for_selector("#record.is-recording[aria-pressed=true] :text-matches('[0-9]:[0-9][2-9]')")
        other.wait_for_selector("#record.is-recording:disabled")
        assert not other.locator("#snapshot").count()
        page.wait_for_selector("#state-disk:has-text('REC')", state="attached")
        open_panel(page, "happened")
        page.wait_for_selector(".happened-row:has-text('being written: a recording')")
        page.keyboard.press("i")
        page.wait_for_selector(".q-notification:has-text('snapshot of eye')")
        page.wait_for_selector(".q-notification:has-text('no snapshot of eye/compressed')")
        page.click("#record")
        other.wait_for_selector("#record:not(.is-recording):has-text('REC')")
        recording_comes_home(page, tmp_path)
        snapshot_comes_home(page, tmp_path)
        for path in ("recordings/20260101T000000Z", "recordings/..%2f..", "snapshots/..%2ftold.txt"):
            assert page.request.get(f"{address.partition('login')[0]}{path}").status == 404


def recording_comes_home(page: Page, folder: Path) -> None:
    with page.expect_download() as found:
        page.click(f"{ROW.format('recording')} a")
    found.value.save_as(folder / "recording.mcap")
    with open_log(folder / "recording.mcap") as log:
        assert {"map_pose", "eye"} <= {one.topic for one in log.channels}
        assert log.end_ns - log.start_ns > 1e9


def snapshot_comes_home(page: Page, folder: Path) -> None:
    with page.expect_download() as found:
        page.click(f"{ROW.format('snapshot')}:has-text('eye') a")
    assert found.value.suggested_filename.endswith("Z-eye.jpg")
    found.value.save_as(folder / "eye.jpg")
    with PillowImage.open(folder / "eye.jpg") as picture:
        taken = picture.getexif().get_ifd(EXIF_PART)[TAKEN]
        assert np.asarray(picture)[0, 0, 0] > 150  # red, but for the losses of JPEG
    assert 0 <= time.time() - time_from(taken.replace(":", "-", 2).replace(" ", "T") + "Z").timestamp() < 200


@pytest.mark.parametrize("is_compressed", [False, True])
def test_snapshot_has_the_picture_and_the_time_at_which_it_was_taken(is_compressed: bool) -> None:
    pixels = np.full((40, 300, 3), (10, 120, 30), np.uint8)
    message: Image | CompressedImage = Image(
        height=40, width=300, encoding="rgb8", step=900, data=pixels.ravel()
    )
    if is_compressed:
        file = io.BytesIO()
        PillowImage.fromarray(pixels).save(file, "PNG")
        message = CompressedImage(format="png", data=np.frombuffer(file.getvalue(), np.uint8))
    taken_s = time_from("2026-11-30T09:12:03.045Z").timestamp()
    with PillowImage.open(io.BytesIO(stamped(message, "front", taken_s))) as shown:
        about = shown.getexif().get_ifd(EXIF_PART)
        assert (about[TAKEN], about[TAKEN_FRACTION]) == ("2026:11:30 09:12:03", "045")
        assert shown.getpixel((150, 20)) == pytest.approx((10, 120, 30), abs=4)
        line = np.asarray(shown)[40:]
        assert line.shape[0] >= 16
        assert (line > 200).any(), "nothing is written below the picture"
    assert name_of("front/left eye", taken_s) == "20261130T091203.045Z-front-left-eye.jpg"
    assert time_text(taken_s) == "2026-11-30T09:12:03.045Z"


def test_what_is_no_picture_is_no_snapshot() -> None:
    with pytest.raises(NoPicture):
        stamped(CompressedImage(format="jpeg", data=np.zeros(9, np.uint8)), "eye", 0.0)


@pytest.fixture
def recorder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunRecorder:
    """A recorder whose recordings are processes that only wait."""
    monkeypatch.setattr(recordings, "start_apart", sleeper(60.0))
    return RunRecorder("run", tmp_path, tmp_path, LOG)


def sleeper(seconds: float) -> Callable[..., object]:
    code = f"import time; print('it is over', flush=True); time.sleep({seconds})"

    def start(arguments: list[str], folder: Path, output: Path) -> object:
        Path(arguments[-1]).mkdir()
        with output.open("wb") as file:
            return subprocess.Popen(["python3", "-c", code], stdout=file, stderr=file)

    return start


def ended(recorder: RunRecorder) -> bool:
    recorder.tick()
    return not recorder.name


def test_recording_ends_before_the_disk_is_full(
    recorder: RunRecorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder.start()
    assert recorder.name
    assert not ended(recorder)
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: Usage(5e8))
    wait_until(lambda: ended(recorder))
    assert recorder.error == DISK_FULL
    recorder.start()
    assert not recorder.name
    assert len(saved_recordings(tmp_path)) == 1


def test_recording_that_dies_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "start_apart", sleeper(0.0))
    recorder = RunRecorder("run", tmp_path, tmp_path, LOG)
    recorder.start()
    wait_until(lambda: ended(recorder))
    assert recorder.error == "it is over"


def test_two_recordings_in_one_second_have_two_names(recorder: RunRecorder, tmp_path: Path) -> None:
    for _ in range(2):
        recorder.start()
        recorder.start()  # once more has no effect
        recorder.close()
    found = saved_recordings(tmp_path)
    assert len({one.name for one in found}) == 2
    assert all(0 <= time.time() - one.time_s < 100 for one in found)


@pytest.mark.parametrize("folder", [SNAPSHOTS, recordings.RECORDINGS])
def test_what_is_removed_while_it_is_listed_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    (tmp_path / folder).mkdir()
    for second in range(3):
        if folder == SNAPSHOTS:
            (tmp_path / folder / name_of("eye", second)).write_bytes(b"picture")
        else:
            (tmp_path / folder / f"20261130T12000{second}Z").mkdir()
    look = Path.iterdir

    def lists_and_removes(path: Path) -> Iterator[Path]:
        """List a folder, whose middle entry somebody removes before it is looked at."""
        found = sorted(look(path))
        for at, one in enumerate(found):
            if at == 1 and one.is_dir():
                monkeypatch.setattr(Path, "is_dir", lambda _path: True)
                one.rmdir()
            elif at == 1:
                one.unlink()
        yield from found

    monkeypatch.setattr(Path, "iterdir", lists_and_removes)
    saved = saved_snapshots(tmp_path) if folder == SNAPSHOTS else saved_recordings(tmp_path)
    assert len(saved) == 2
    monkeypatch.undo()
    shutil.rmtree(tmp_path / folder)
    assert not saved_snapshots(tmp_path) + saved_recordings(tmp_path)
