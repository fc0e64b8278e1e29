"""A log is played into a robot of processes; the playback is controlled and killed."""

import os
import pty
import select
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_mp.cli.playback import give_order
from robbie_mp.logs.playback.outlet import PATIENCE_NS
from robbie_mp.logs.playback.player import PlaybackRefused
from robbie_mp.messages import DriveCommand, Image, PlaybackState, String
from tests._support.robot import COMMAND, LIMIT_S, Ended, Robot, kill, wait_until
from tests.logs._support.battery_log import write_battery_log
from tests.logs.conftest import PROFILE
from tests.logs.recording._support.logs import START_NS, STEP_NS, LogFile

COUNT = 60


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_battery_log(tmp_path / "log.mcap", COUNT)


def start(robot: Robot, log: Path, *options: str) -> Any:
    return robot.start(*options, command=("play", str(log)))


def witnessed(robot: Robot, *kinds: str) -> list[list[str]]:
    """Lines of the witness: words, without those of other kinds."""
    file = robot.output / "witness.txt"
    lines = [line.split() for line in file.read_text().splitlines()] if file.exists() else []
    return [words for words in lines if not kinds or words[1] in kinds]


def numbers(robot: Robot) -> list[int]:
    return [round(float(words[2])) for words in witnessed(robot, "command")]


@contextmanager
def keyboard(robot: Robot) -> Iterator[Callable[[bytes], int]]:
    """`robbie playback keys` on a terminal; yields what presses keys."""
    ours, its = pty.openpty()
    command = [*COMMAND, "playback", "keys"]
    process = subprocess.Popen(command, stdin=its, stdout=its, cwd=robot.folder, stderr=subprocess.PIPE)
    os.close(its)
    try:
        shown = b""
        while b"paused at" not in shown:
            assert select.select([ours], [], [], LIMIT_S)[0]
            shown += os.read(ours, 1000)
        yield lambda keys: os.write(ours, keys)
        os.write(ours, b"q")
        assert process.wait(LIMIT_S) == 0
    finally:
        process.kill()
        process.communicate()
        os.close(ours)


class Steered:
    """Gives orders to the playback of the one run there is."""

    def __init__(self, robot: Robot):
        self._robot = robot
        robot.until(lambda modules: modules["playback"]["state"] == "RUNNING")

    def __call__(self, order: str, value: float = 0.0) -> PlaybackState:
        run = self._robot.known_run()
        return give_order(run, order, value)

    def step(self) -> None:
        """Play one message, and wait until it has been handled."""
        before = len(witnessed(self._robot, "command", "battery"))
        self("step")
        wait_until(lambda: len(witnessed(self._robot, "command", "battery")) > before)


@pytest.mark.slow
def test_controlled_and_killed_playback_loses_and_repeats_no_message(player_robot: Robot, log: Path) -> None:
    process = start(player_robot, log, "--paused", "--topics", "DriveCommand", "battery", "strange", "no/*")
    steer = Steered(player_robot)
    for number in (1, 2, 3):
        steer.step()
        assert numbers(player_robot) == list(range(1, number + 1))
    state = steer("pause")
    assert (state.position.nanoseconds, state.messages) == (START_NS + 2 * STEP_NS, 3)
    with pytest.raises(PlaybackRefused, match=r"0 to 5\.9 s"):
        steer("seek", 100.0)
    assert "float32 number" in player_robot.command("type", "show", "Stranger").stdout  # by the log's schema

    pid = player_robot.top()["playback"]["pid"]
    kill(pid)
    player_robot.until(lambda modules: modules["playback"]["restarts"] == 1 and modules["playback"]["pid"])
    steer.step()
    assert numbers(player_robot) == [1, 2, 3, 4]

    assert steer("seek", 4.95).jumps == 1
    with keyboard(player_robot) as press:
        press(b".")
        wait_until(lambda: numbers(player_robot)[-1] == 51)
    steer("rate", float("inf"))
    steer("resume")
    ended = Ended.wait_for(process)
    assert ended.exit_code == 0, ended.stderr
    assert numbers(player_robot) == [1, 2, 3, 4, *range(51, COUNT + 1)]
    assert [words[2:] for words in witnessed(player_robot, "battery")] == [["50", "4"]] * 2
    assert [words[2:] for words in witnessed(player_robot, "jump")] == [["seek"]]
    assert clock_went_back(player_robot) == []
    assert "nothing in" in player_robot.log("playback")
    assert "refused seek" in player_robot.log("playback")
    assert ended.modules["playback"]["refused"] == ended.modules["witness"]["dropped"] == 0


def clock_went_back(robot: Robot) -> list[tuple[int, int]]:
    """Where the run's time went back without a jump; messages bear the log's times."""
    found, before_ns = [], 0
    for words in witnessed(robot):
        now_ns = int(words[0])
        if words[1] == "jump":
            before_ns = 0
        if now_ns < before_ns:
            found.append((before_ns, now_ns))
        before_ns = now_ns
        if words[1] == "command":
            assert now_ns >= START_NS + (round(float(words[2])) - 1) * STEP_NS
    return found


@pytest.mark.slow
def test_runs_in_lockstep_are_identical_even_if_the_playback_is_killed(
    player_robot: Robot, log: Path
) -> None:
    options = ["--lockstep", "--rate", "max", "--topics", "DriveCommand", "battery"]
    ended = Ended.wait_for(start(player_robot, log, *options))
    assert ended.exit_code == 0, ended.stderr
    first = witnessed(player_robot)
    assert [round(float(words[2])) for words in first if words[1] == "command"] == list(range(1, COUNT + 1))
    assert [int(words[0]) - START_NS for words in first if words[1] == "command"] == [
        number * STEP_NS for number in range(COUNT)
    ]
    ticks = [int(words[0]) - START_NS for words in first if words[1] == "tick"]
    assert ticks == [number * STEP_NS for number in range(COUNT)]
    player_robot.output = player_robot.folder / "killed"
    process = start(player_robot, log, *options, "--paused")
    steer = Steered(player_robot)
    for _ in range(7):
        steer.step()
    kill(player_robot.top()["playback"]["pid"])
    player_robot.until(lambda modules: modules["playback"]["restarts"] == 1 and modules["playback"]["pid"])
    steer("resume")
    assert Ended.wait_for(process).exit_code == 0
    assert witnessed(player_robot) == first


@pytest.mark.slow
def test_charged_handler_times_of_an_earlier_playback_repeat_it(player_robot: Robot, log: Path) -> None:
    options = ["--lockstep", "--rate", "max", "--topics", "DriveCommand", "battery", "--charge"]
    ended = Ended.wait_for(start(player_robot, log, *options, "measured"))
    assert ended.exit_code == 0, ended.stderr
    first, times = witnessed(player_robot), player_robot.output / "handler_times"
    assert len(first) > COUNT
    player_robot.output = player_robot.folder / "again"
    ended = Ended.wait_for(start(player_robot, log, *options, str(times)))
    assert ended.exit_code == 0, ended.stderr
    assert witnessed(player_robot) == first
    assert (player_robot.output / "handler_times" / "witness.txt").read_text() == (
        times / "witness.txt"
    ).read_text()


@pytest.mark.slow
def test_seek_and_end_do_not_wait_for_an_image_that_a_page_shows(player_robot: Robot, tmp_path: Path) -> None:
    """Only for handlers: what was handled may be kept for ever."""
    limit_s = PATIENCE_NS / 1e9 / 2
    with LogFile(tmp_path / "images.mcap") as images:
        for number in range(20):
            pixels = np.full(100, number, np.uint8)
            images.add(
                Image(width=10, height=10, encoding="mono8", step=10, data=pixels),
                "eye",
                time_ns=START_NS + number * STEP_NS,
            )
    player_robot.write_profile(
        PROFILE.replace("witness:", "keeper: {class: crew.modules:Keeper}\n  witness:")
    )
    process = start(player_robot, tmp_path / "images.mcap", "--paused")
    steer = Steered(player_robot)
    steer("step")
    player_robot.until(lambda modules: modules["keeper"]["status"] == "keeps 0")
    steer("seek", 1.0)
    assert wait_until(lambda: witnessed(player_robot, "jump") != []) < limit_s
    steer("step")
    player_robot.until(lambda modules: modules["keeper"]["status"] == "keeps 10")
    steer("rate", float("inf"))
    began_s = time.monotonic()
    steer("resume")
    ended = Ended.wait_for(process)
    assert ended.exit_code == 0, ended.stderr
    assert time.monotonic() - began_s < limit_s
    assert ended.modules["keeper"]["status"] == "keeps 19"


@pytest.mark.slow
def test_unplayable_log_is_refused_before_any_process_starts(
    player_robot: Robot, tmp_path: Path, log: Path
) -> None:
    newer = write_battery_log(tmp_path / "newer.mcap", 5, battery_version=4)
    refused = player_robot.command("play", str(newer), "robot")
    assert refused.returncode == 2
    assert "played_msgs/msg/Battery: version 4 was written, 3 is the newest here" in refused.stderr
    player_robot.write_profile('modules: {witness: {class: "crew.modules:Witness"}}', "real")
    refused = player_robot.command("play", str(log), "real")
    assert refused.returncode == 2
    assert "no module 'playback', only witness" in refused.stderr
    player_robot.write_profile(
        'modules: {playback: {class: "robbie_mp.logs.playback.module:Playback"}}', "own"
    )
    refused = player_robot.command("play", str(log), "own")
    assert refused.returncode == 2
    assert "`clock: {source: playback}`" in refused.stderr
    assert not (player_robot.folder / "output").exists()


def foreign_log(path: Path) -> Path:
    """A log of another program: from 1970 and 2026, with a type that does not fit, text, and an odd scan."""
    with LogFile(path) as log:
        foreign = log.writer.register_channel
        schemas = [
            log.writer.register_schema(name, "ros2msg", text.encode())
            for name, text in (
                ("std_msgs/msg/String", "string data"),
                ("geometry_msgs/msg/Point", "float32 x"),
            )
        ]
        said, odd = (
            foreign(f"/{name}", "cdr", id_) for name, id_ in zip(("said", "odd"), schemas, strict=True)
        )
        text = foreign("/text", "json", 0)
        for number, time_ns in enumerate([0, STEP_NS, START_NS, START_NS + STEP_NS]):
            log.add_bytes(said, String(data=str(number)).encode(), time_ns)
            log.add_bytes(odd, b"\0\1\0\0\0\0\0\0", time_ns)
            log.add_bytes(text, b"{}", time_ns)
        log.add(DriveCommand(linear_m_per_s=1.0), time_ns=START_NS + STEP_NS)
        log.add(DriveCommand(linear_m_per_s=float("nan")), time_ns=START_NS + STEP_NS)
    return path


def said_by_playback(robot: Robot) -> str:
    return (robot.output / "log" / "playback.jsonl").read_text()


@pytest.mark.slow
def test_playback_says_what_it_left_out_and_where_time_jumped(player_robot: Robot, tmp_path: Path) -> None:
    ended = Ended.wait_for(start(player_robot, foreign_log(tmp_path / "log.mcap"), "--rate", "max"))
    assert ended.exit_code == 1
    balance = {
        "messages of 'odd', whose geometry_msgs/msg/Point does not fit: it has other fields than ours": 4,
        "messages of 'text', which are encoded as 'json'": 4,
        "ill-formed messages of 'DriveCommand'": 1,
    }
    assert ended.summary["balance"] == {"used": 5, "left_out": balance}
    assert "read 14 messages: 5 used, 9 left out" in ended.stderr
    assert "time jumps from 1970-01-01T00:00:00.100Z to 2023-11-14" in said_by_playback(player_robot)
    assert all(reason in ended.stderr for reason in balance)
    assert [words[2] for words in witnessed(player_robot, "jump")] == ["gap"]


@pytest.mark.slow
def test_strict_playback_refuses_what_it_would_leave_out(player_robot: Robot, tmp_path: Path) -> None:
    log = foreign_log(tmp_path / "log.mcap")
    refused = player_robot.command("play", str(log), "robot", "--strict")
    assert refused.returncode == 2
    assert "messages of 'text', which are encoded as 'json'" in refused.stderr
    options = ["--rate", "max", "--strict", "--topics", "said", "DriveCommand"]
    ended = Ended.wait_for(start(player_robot, log, *options))
    assert ended.exit_code == 1
    assert "strict allows no loss: ill-formed messages of 'DriveCommand'" in said_by_playback(player_robot)
