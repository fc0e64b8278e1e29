"""What a power cut leaves on the disk becomes a clip, however its end is torn."""

import logging
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import psutil
import pytest

from robbie_mp.logs.black_box import spool as spool_module
from robbie_mp.logs.black_box.clip_folder import SavedClip, clip_folders, saved_clips
from robbie_mp.logs.black_box.power_loss import recover
from robbie_mp.logs.black_box.ring import ring_home
from robbie_mp.logs.black_box.salvage import salvage
from robbie_mp.logs.black_box.spool import ABOUT, LOG, MAX_MESSAGE_BYTES, SPOOL, AboutSpool, Spool, locked
from robbie_mp.logs.black_box.state import MAX_TRIGGERS, OpenClip
from robbie_mp.logs.recording.format import ChannelKey, part_path
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.run.run_directory import RECORD_NAME, RunRecord
from tests._support.robot import Ended, Robot, kill, wait_until
from tests.logs.black_box.test_black_box import PROFILE, box, start
from tests.logs.recording._support.logs import START_NS, STEP_NS, write_log

OF_NO_RUN = AboutSpool("0000dead", "robot", 1 << 30)
KEY = ChannelKey("sensor_msgs/msg/LaserScan", 1, "front", "source")


def left_spool(folder: Path, parts: int = 2) -> Path:
    """Write what a dead run has left."""
    spool = folder / SPOOL
    (spool / LOG).mkdir(parents=True)
    (spool / ABOUT).write_bytes(msgspec.json.encode(OF_NO_RUN))
    for number in range(parts):
        write_log(part_path(spool / LOG, number), 60)
    return spool


def clips(folder: Path) -> list[SavedClip]:
    return saved_clips(clip_folders(folder))


def cut(part: Path) -> None:
    part.write_bytes(part.read_bytes()[:-3000])


def zeros(part: Path) -> None:
    data = part.read_bytes()
    part.write_bytes(data[:-3000] + bytes(5000))


def emptied(part: Path) -> None:
    part.write_bytes(b"")


@pytest.mark.parametrize("tear", [cut, zeros, emptied])
def test_torn_spool_becomes_a_whole_clip(tmp_path: Path, tear: Callable[[Path], None]) -> None:
    spool = left_spool(tmp_path)
    tear(part_path(spool / LOG, 1))
    (line,) = recover([spool])
    assert "lost its power, and has left a clip" in line
    (clip,) = clips(tmp_path)
    assert clip.about is not None and clip.about.triggers == ["power lost"]
    with open_log(clip.folder) as log:
        assert log.message_count >= 60
        assert clip.about.times_s == [log.end_ns / 1e9]
    assert not spool.exists()
    assert recover([spool]) == []


def test_name_of_the_clip_is_the_time_of_the_loss_and_not_of_the_next_start(tmp_path: Path) -> None:
    recover([left_spool(tmp_path)])
    (clip,) = clips(tmp_path)
    lost_s = (START_NS + 59 * STEP_NS) / 1e9
    assert clip.folder.name.startswith(time.strftime("%Y%m%dT%H%M", time.gmtime(lost_s)))


def test_spool_of_a_live_black_box_is_left_alone(tmp_path: Path) -> None:
    spool = left_spool(tmp_path)
    with locked(spool) as is_mine:
        assert is_mine
        assert recover([spool]) == []
    assert spool.exists() and not clips(tmp_path)


def test_power_cut_before_anything_was_written_is_said(tmp_path: Path) -> None:
    (line,) = recover([left_spool(tmp_path, parts=0)])
    assert "before anything was on the disk" in line


def test_clip_that_was_being_written_is_said_to_be_not_whole(tmp_path: Path) -> None:
    (tmp_path / "clips" / "20261129T040000Z-mark-x").mkdir(parents=True)
    lines = recover([left_spool(tmp_path)])
    assert any("mark-x is not whole" in line for line in lines)


def test_folder_that_only_has_the_name_of_a_spool_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / SPOOL).mkdir()
    (tmp_path / SPOOL / "mine.txt").write_text("mine")
    assert recover([tmp_path / SPOOL]) == []
    (tmp_path / SPOOL / ABOUT).write_text("no JSON")
    assert "cannot be read" in recover([tmp_path / SPOOL])[0]
    assert {one.name for one in (tmp_path / SPOOL).iterdir()} == {"mine.txt", ABOUT}


def test_run_that_is_killed_before_its_first_message_leaves_no_spool(tmp_path: Path) -> None:
    record = RunRecord(OF_NO_RUN.run_id, "robot", 1, 1, "", "", str(tmp_path), "", is_robot=True)
    (tmp_path / RECORD_NAME).write_bytes(msgspec.json.encode(record))
    spool = left_spool(tmp_path, parts=0)
    assert salvage(record.run_id, tmp_path, tmp_path / "memory") == []
    assert not spool.exists()


class FakeRun(SimpleNamespace):
    """As much of a run as a spool asks for."""

    def latched(self) -> set[Any]:
        return set()


def test_stalled_disk_costs_the_spool_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recovers = threading.Event()
    monkeypatch.setattr(spool_module, "make_private_folder", lambda _folder: recovers.wait(60))
    monkeypatch.setattr(spool_module, "CLOSE_S", 0.1)
    run: Any = FakeRun()
    spool = Spool(tmp_path, OF_NO_RUN, run, 1 << 20, 1.0, logging.getLogger())
    began_s = time.thread_time()
    for number in range(1000):
        spool.keep(KEY, number, 0, bytes(MAX_MESSAGE_BYTES))
    assert time.thread_time() - began_s < 1.0
    spool.close()  # returns, although the disk does not
    recovers.set()


def test_trigger_that_flips_is_named_once_a_second() -> None:
    clip = OpenClip("n", 0, 0, 0)
    for number in range(1000):  # 100 Hz for 10 s
        clip.add("limit", number * 10_000_000, 5.0, 5.0)
    assert len(clip.triggers) == 10
    assert clip.count == 1000
    assert clip.until_ns <= 60_000_000_000


def test_clock_set_ahead_or_back_changes_nothing_about_triggers() -> None:
    clip = OpenClip("n", 0, 0, 0)
    assert clip.add("limit", 0, 10_000.0, 5.0)
    assert not clip.add("limit", 100_000_000, 13_600.0, 5.0)
    assert clip.add("limit", 2_000_000_000, 6_400.0, 5.0)


def test_flood_of_different_marks_is_bounded() -> None:
    clip = OpenClip("n", 0, 0, 0)
    for number in range(3000):
        clip.add(f"mark: {number}", number * 20_000_000, 5.0, 5.0)
    assert len(clip.triggers) == len(clip.times_s) == len(clip.told_ns) == MAX_TRIGGERS
    assert clip.count == 3000


# -- whole robots --------------------------------------------------------------------------------------

SPOOLING = PROFILE.replace("after_s: 1,", "after_s: 1, spool_s: 0.3,")


def spooled_bytes(robot: Robot) -> int:
    return sum(path.stat().st_size for path in (robot.output / SPOOL / LOG).glob("*.mcap"))


def kill_everything(robot: Robot, supervisor: int) -> None:
    """Kill all processes of a run as the end of its cgroup does."""
    all_of_it = [psutil.Process(supervisor), *psutil.Process(supervisor).children(recursive=True)]
    for process in all_of_it:
        process.suspend()
    for process in all_of_it:
        kill(process.pid)
    wait_until(lambda: not robot.top())


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_power_cut_leaves_a_clip(robot: Robot) -> None:
    process = start(robot, SPOOLING)
    wait_until(lambda: box(robot)["state"] == "RUNNING" and spooled_bytes(robot) > 10_000)
    run = robot.known_run()
    kill_everything(robot, process.pid)
    process.wait(60)
    shutil.rmtree(run.folder)  # both are in memory, and so gone after a power cut
    shutil.rmtree(ring_home(run.run_id).parent)
    listed = robot.command("clips", "--in", str(robot.output))
    assert "lost its power, and has left a clip" in listed.stderr, listed
    (clip,) = clips(robot.output)
    assert clip.about is not None and clip.about.triggers == ["power lost"]
    with open_log(clip.folder) as log:
        assert log.message_count > 20
        assert max(len(one.data) for one in log.messages()) <= MAX_MESSAGE_BYTES
    assert not (robot.output / SPOOL).exists()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_everything_killed_at_once_leaves_one_clip_of_the_ring_and_no_spool(robot: Robot) -> None:
    process = start(robot, SPOOLING)
    wait_until(lambda: box(robot)["state"] == "RUNNING" and spooled_bytes(robot) > 10_000)
    kill_everything(robot, process.pid)
    process.wait(60)
    assert "has left a clip when it was killed" in robot.command("clips", "--in", str(robot.output)).stderr
    (clip,) = clips(robot.output)
    assert clip.about is not None and clip.about.triggers == ["the supervisor was killed"]
    assert not (robot.output / SPOOL).exists()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_orderly_end_leaves_no_spool(robot: Robot) -> None:
    process = start(robot, SPOOLING)
    wait_until(lambda: box(robot)["state"] == "RUNNING" and spooled_bytes(robot) > 10_000)
    process.terminate()
    Ended.wait_for(process)
    assert not (robot.output / SPOOL).exists()
