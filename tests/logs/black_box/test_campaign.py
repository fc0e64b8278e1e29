"""The black box under kills and floods: every trigger has its clip, or is counted as missed."""

import json
import random
import re
import signal
from collections import Counter
from pathlib import Path

import pytest

from robbie_mp.logs.black_box.clip_folder import SavedClip, clip_folders, saved_clips
from robbie_mp.logs.recording.reader import open_log
from tests._support.robot import Ended, Robot, kill, wait_until
from tests.logs.black_box.test_black_box import MODULES, PROFILE, box, start

pytestmark = [pytest.mark.slow, pytest.mark.every_turn, pytest.mark.timeout(600)]
KILLS = 5
LOGGER = "  logger: {class: robbie_mp.logs.message_logger:MessageLogger}\nblack_box:"
FLOOD = """
modules:
  source: {class: "acts:Fast"}
  camera: {class: "acts:Flood"}
black_box: {before_s: 5, after_s: 1, ring_bytes: 16777216}
"""
FLOODING = '''

class Fast(Source):
    """Publishes a thousand times a second."""

    period_s = 0.001

class Flood(Module):
    """Publishes depth images of 6 MB, which cannot be JPEG."""

    period_s = 0.033

    def setup(self):
        self.pixels = np.random.default_rng(1).integers(0, 255, 6_000_000, np.uint8)

    def tick(self):
        self.publish(Image(height=1000, width=3000, encoding="16UC1", step=6000, data=self.pixels), topic="d")
'''


def all_clips(robot: Robot) -> list[SavedClip]:
    return [clip for clip in saved_clips(clip_folders(robot.output)) if clip.about]


def triggers_in(robot: Robot) -> list[str]:
    return [text for clip in all_clips(robot) if clip.about for text in clip.about.triggers]


def account(log: str) -> list[int]:
    """Return triggers, those with a clip, and missed ones; zeros if the black box was killed at the end."""
    found = re.findall(r"(\d+) triggers, (\d+) with a clip on the disk, (\d+) missed", log)
    return [int(number) for number in found[-1]] if found else [0, 0, 0]


def kill_and_mark(
    robot: Robot, names: list[str], chance: random.Random
) -> tuple[Counter[str], list[str], list[str]]:
    """Kill and mark, again and again; return who was killed, and the marks that were confirmed or not."""
    killed: Counter[str] = Counter()
    marks: list[str] = []
    unconfirmed: list[str] = []
    for number in range(KILLS):
        name = chance.choice(names)
        kill(robot.until(lambda m: m[name]["state"] == "RUNNING")[name]["pid"])  # noqa: B023
        killed[name] += 1
        ended = robot.command("mark", f"number {number}")
        (marks if ended.returncode == 0 else unconfirmed).append(f"mark: number {number}")
    return killed, marks, unconfirmed


def assert_clips_are_sound(robot: Robot) -> None:
    for clip in all_clips(robot):
        with open_log(clip.folder) as log:
            assert log.message_count
            sequences = [message.sequence for message in log.messages()]
            assert sequences == sorted(set(sequences))  # nothing twice, nothing out of order


def test_every_trigger_has_its_clip_while_core_logger_and_black_box_are_killed(robot: Robot) -> None:
    names = ["core", "black_box", "logger", "victim"]
    process = start(
        robot, PROFILE.replace(', triggers: ["battery.percentage < 0.1"]', "").replace("black_box:", LOGGER)
    )
    wait_until(lambda: box(robot)["state"] == "RUNNING" and box(robot)["handled"] > 100)
    killed, marks, unconfirmed = kill_and_mark(robot, names, random.Random(38))
    robot.until(lambda m: all(m[name]["state"] == "RUNNING" for name in names))
    process.send_signal(signal.SIGINT)
    Ended.wait_for(process)
    found = triggers_in(robot)
    total, written, missed = account(robot.log("black_box"))
    assert total == written + missed
    assert not [mark for mark in marks if mark not in found] or missed
    lost = [mark for mark in (*marks, *unconfirmed) if mark not in found]
    assert len(lost) <= missed, (lost, robot.log("black_box")[-2000:])
    for name in killed:
        assert any(text.startswith(f"{name} ended: killed by SIGKILL") for text in found) or missed, name
    assert_clips_are_sound(robot)
    print(f"{dict(killed)} kills, {len(marks)} marks, {unconfirmed}, {total} triggers, {missed} missed")


def test_supervisor_killed_after_others_and_amid_a_flood_owes_no_confirmed_mark(robot: Robot) -> None:
    process = start(robot, FLOOD.replace("black_box:", LOGGER), MODULES + FLOODING)
    wait_until(lambda: box(robot)["state"] == "RUNNING" and box(robot)["handled"] > 1000)
    killed, marks, unconfirmed = kill_and_mark(robot, ["core", "black_box", "logger"], random.Random(39))
    kill(process.pid)
    process.wait(60)
    wait_until(lambda: not robot.top())
    told = robot.command("clean").stderr
    found = triggers_in(robot)
    assert "the supervisor was killed" in found, told
    assert [mark for mark in marks if mark not in found] == [], told
    assert_clips_are_sound(robot)
    print(f"{dict(killed)} kills, {len(marks)} marks, {unconfirmed} not confirmed")


def test_supervisor_killed_while_triggers_come_owes_no_clip(robot: Robot) -> None:
    process = start(robot)
    wait_until(lambda: box(robot)["state"] == "RUNNING" and box(robot)["handled"] > 100)
    assert robot.command("mark", "last words").returncode == 0
    kill(process.pid)
    process.wait(60)
    wait_until(lambda: not robot.top())
    assert "has left a clip" in robot.command("clean").stderr
    assert {"mark: last words", "the supervisor was killed"} <= set(triggers_in(robot))
    assert "has left a clip" not in robot.command("clean").stderr


def test_flood_stays_within_the_ring_and_marks_get_through(robot: Robot) -> None:
    process = start(robot, FLOOD, MODULES + FLOODING)
    wait_until(lambda: box(robot)["state"] == "RUNNING" and box(robot)["handled"] > 3000)
    sizes = []

    def ring_bytes() -> int:
        ring = next(Path("/dev/shm").glob(f"**/robbie-{robot.known_run().run_id}/black_box/ring"))
        sizes.append(sum(path.stat().st_size for path in ring.glob("*.mcap")))
        return sizes[-1]

    wait_until(lambda: ring_bytes() > 0 and box(robot)["handled"] > 10_000)
    told = json.loads(robot.command("mark", "flood", "--json").stdout)
    process.send_signal(signal.SIGINT)
    Ended.wait_for(process)
    assert max(sizes) < 1.4 * 16777216
    with open_log(Path(told["clip"])) as log:
        assert log.message_count > 300
