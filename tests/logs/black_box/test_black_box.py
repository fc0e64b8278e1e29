"""The black box in a run: clips of crashes, stops, marks and limits, also when processes are killed."""

import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.logs.black_box.clip_folder import SavedClip, clip_folders, saved_clips
from robbie_mp.logs.recording.info import last_counts
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import Image, LaserScan, Mark, OccupancyGrid
from tests._support.left_behind import leaving_nothing_behind
from tests._support.robot import Ended, Robot, kill, robot_in, wait_until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

MODULES = '''
import numpy as np

from robbie_mp import Module
from robbie_mp.messages import BatteryState, EmergencyStop, Image, LaserScan, Mark, OccupancyGrid


class Source(Module):
    """Publishes numbered scans, and a map once, which is latched."""

    period_s = 0.01

    def setup(self):
        self.number = self.restored or 0
        self.publish(OccupancyGrid(data=np.zeros(1000, np.int8)), topic="map", latched=True)

    def tick(self):
        self.number += self.publish(LaserScan(angle_min=float(self.number)), topic="front")
        self.publish(BatteryState(percentage=0.05 if self.number > 100_000 else 0.9), topic="battery")
        self.checkpoint(self.number)


class Camera(Module):
    """Publishes large images."""

    period_s = 0.04

    def tick(self):
        pixels = np.random.default_rng(1).integers(0, 255, 480 * 640 * 3, np.uint8)
        self.publish(Image(height=480, width=640, encoding="rgb8", step=640 * 3, data=pixels), topic="camera")


class Victim(Module):
    """Crashes, hangs and stops on command."""

    def setup(self):
        self.subscribe(Mark, self.on_mark, topic="do")

    def on_mark(self, mark):
        if mark.text == "crash":
            raise RuntimeError("as told")
        if mark.text == "stop":
            self.publish(EmergencyStop(engaged=True, reason="as told"), topic="emergency_stop")
'''
PROFILE = """
modules:
  source: {class: "acts:Source"}
  camera: {class: "acts:Camera"}
  victim: {class: "acts:Victim", restart: {backoff_s: 0.01, max_restarts: 1000}}
black_box: {before_s: 3, after_s: 1, triggers: ["battery.percentage < 0.1"]}
"""


@pytest.fixture(autouse=True)
def nothing_left_behind() -> None:
    """Do not look after each test: one robot runs through several, and restarts modules meanwhile."""


@pytest.fixture(scope="module")
def acting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with leaving_nothing_behind(), robot_in(tmp_path_factory.mktemp("acting")) as robot:
        start(robot)
        wait_until(lambda: box(robot)["state"] == "RUNNING" and scans_seen(robot) > 50)
        yield robot


def start(robot: Robot, profile: str = PROFILE, modules: str = MODULES) -> "subprocess.Popen[str]":
    (robot.folder / "acts.py").write_text(modules)
    robot.write_profile(profile, has_black_box=True)
    return robot.start()


def box(robot: Robot) -> dict[str, Any]:
    return robot.top().get("black_box", {"state": "-", "status": "", "handled": 0})


def scans_seen(robot: Robot) -> int:
    return int(box(robot)["handled"])


def do(robot: Robot, what: str) -> None:
    ended = robot.command("pub", "Mark", f"{{text: {what}}}", "--topic", "do")
    assert ended.returncode == 0, ended.stderr


def clips(robot: Robot) -> list[SavedClip]:
    return [clip for clip in saved_clips(clip_folders(robot.output)) if clip.about]


def clip_of(robot: Robot, what: str) -> SavedClip:
    """Wait for the clip of a trigger."""

    def found() -> list[SavedClip]:
        return [one for one in clips(robot) if one.about and any(what in text for text in one.about.triggers)]

    wait_until(lambda: bool(found()))
    return found()[0]


def numbers(folder: Path) -> list[int]:
    with open_log(folder) as log:
        front = [channel for channel in log.channels if channel.topic == "front"]
        return [round(LaserScan.decode(m.data).angle_min) for m in log.messages(channels=front)]


def test_crash_has_a_clip_with_what_was_before_and_after(acting: Robot) -> None:
    do(acting, "crash")
    clip = clip_of(acting, "victim ended: exit code 1")
    assert clip.about is not None and clip.about.missing == ""
    found = numbers(clip.folder)
    with open_log(clip.folder) as log:
        assert log.is_complete
        dropped = sum(count.dropped for part in log.parts for count in last_counts(part).values())
        assert found[-1] + 1 - found[0] - len(found) <= dropped  # a busy machine may drop some
        (crash_s,) = clip.about.times_s[:1]
        assert log.start_ns < (crash_s - 0.3) * 1e9 and log.end_ns > (crash_s + 0.5) * 1e9
        maps = [c for c in log.channels if c.type_name == OccupancyGrid.type_name]
        assert maps  # the newest of a latched topic, from before the clip or in it


def test_images_become_a_few_small_ones(acting: Robot) -> None:
    assert acting.command("mark", "look").returncode == 0
    with open_log(clip_of(acting, "mark: look").folder) as log:
        counts = {channel.type_name: count for channel, count in log.counts.items()}
        assert log.end_ns - log.start_ns > 1e9
    assert 2 <= counts["sensor_msgs/msg/CompressedImage"] <= 25
    assert Image.type_name not in counts


def test_mark_prints_its_clip_which_every_log_command_reads(acting: Robot) -> None:
    ended = acting.command("mark", "it is dark", "--json")
    told = json.loads(ended.stdout)
    clip = clip_of(acting, "mark: it is dark")
    assert told == {"text": "it is dark", "clip": str(clip.folder)}
    assert acting.command("info", str(clip.folder)).returncode == 0
    listed = acting.command("clips", "--in", str(acting.output)).stdout
    assert clip.folder.name in listed and "mark: it is dark" in listed
    assert (clip.folder / "metadata.yaml").exists()  # so ROS 2 opens it


def test_emergency_stop_has_a_clip(acting: Robot) -> None:
    do(acting, "stop")
    assert clip_of(acting, "EmergencyStop.engaged == true")


def test_limit_of_the_profile_has_a_clip(acting: Robot) -> None:
    ended = acting.command("pub", "BatteryState", "{percentage: 0.02}", "--topic", "battery")
    assert ended.returncode == 0, ended.stderr
    assert clip_of(acting, "battery.percentage < 0.1")


def test_hung_module_has_a_clip(acting: Robot) -> None:
    os.kill(acting.top()["victim"]["pid"], signal.SIGABRT)
    assert clip_of(acting, "victim ended: killed by SIGABRT")


def test_killed_black_box_goes_on_with_what_it_had(acting: Robot) -> None:
    wait_until(lambda: scans_seen(acting) > 300)
    before = acting.command("mark", "just before")
    assert before.returncode == 0, before.stderr
    kill(box(acting)["pid"])
    clip = clip_of(acting, "mark: just before")
    own = clip_of(acting, "black_box ended: killed by SIGKILL")
    assert own.about is not None and own.about.missing == ""
    with open_log(clip.folder) as log:
        marks = [channel for channel in log.channels if channel.type_name == Mark.type_name]
        assert [Mark.decode(one.data).text for one in log.messages(channels=marks)].count("just before") == 1


def test_killed_supervisor_leaves_a_clip_for_the_next_command(robot: Robot) -> None:
    process = start(robot)
    wait_until(lambda: scans_seen(robot) > 300)
    # On a busy machine these come at once, and what came in the last moment is not in the ring yet.
    before = scans_seen(robot)
    wait_until(lambda: scans_seen(robot) > before + 300)
    kill(process.pid)
    process.wait(60)
    wait_until(lambda: not robot.top())
    cleaned = robot.command("clean")
    assert "has left a clip" in cleaned.stderr, cleaned
    (clip,) = [one for one in clips(robot) if one.about and "the supervisor was killed" in one.about.triggers]
    assert len(numbers(clip.folder)) > 20


def test_full_account_of_a_run_is_in_its_last_line(robot: Robot) -> None:
    # On a busy machine, images fill the queue of the black box before it is read, and triggers are missed.
    process = start(robot, PROFILE.replace('  camera: {class: "acts:Camera"}\n', ""))
    wait_until(lambda: scans_seen(robot) > 100)
    status = re.compile(r"keeps \d+ s")
    wait_until(lambda: status.fullmatch(robot.top()["black_box"]["status"]) is not None)
    assert robot.command("mark", "at the end").returncode == 0
    Ended.in_order(process)
    (clip,) = clips(robot)
    assert clip.about is not None and clip.about.triggers == ["mark: at the end"]
    assert "1 triggers, 1 with a clip on the disk, 0 missed" in robot.log("black_box")


def test_end_of_the_run_in_good_order_is_no_trigger(robot: Robot) -> None:
    robot.write_profile(
        """
modules:
  counter: {class: "zoo.modules:Counter", ends_run: true, settings: {count: 300}}
  listener: {class: "zoo.modules:Listener"}
""",
        has_black_box=True,
    )
    ended = robot.run()
    assert ended.exit_code == 0, ended.stderr
    assert not (robot.output / "clips").exists()


PACED = """
from robbie_mp import Module, setting
from robbie_mp.messages import Point


class Paced(Module):
    waits: bool = setting(True, "whether it is woken when there is room")
    period_s = 0.001

    def tick(self):
        while self.outstanding < 200 and self.publish(Point()):
            pass
        if self.waits:
            self.wake_after_freed(100)


class Sink(Module):
    def setup(self):
        self.subscribe(Point, lambda point: None)
"""


@pytest.mark.parametrize("waits", ["true", "false"])
@pytest.mark.every_turn
def test_module_that_paces_itself_does_not_wait_for_the_black_box(robot: Robot, waits: str) -> None:
    paced = f'paced: {{class: "acts:Paced", settings: {{waits: {waits}}}}}'
    start(robot, f'modules: {{{paced}, sink: {{class: "acts:Sink"}}}}', PACED)
    wait_until(lambda: scans_seen(robot) > 0)
    pid = box(robot)["pid"]
    os.kill(pid, signal.SIGSTOP)
    before = robot.top()["sink"]["handled"]
    wait_until(lambda: robot.top()["sink"]["handled"] > before + 2000)
    assert box(robot)["pid"] == pid, "it was not yet replaced"
