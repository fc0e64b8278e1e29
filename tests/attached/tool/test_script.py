"""Scripts and notebooks listen, publish, and read and change parameters of a live robot."""

import gc
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

import robbie_mp
from robbie_mp import Header, Message, Time, float64
from robbie_mp.attached.tool.script import AttachedRun, NotAttached, NothingHeard
from robbie_mp.attached.tool.tool import RunEnded
from robbie_mp.messages import DriveCommand, IllFormed, Image, Point, Pose, PoseStamped
from robbie_mp.module.calls.errors import CallRefused, CallTimedOut, NoServer
from robbie_mp.module.setting_changes import NotChangeable
from robbie_mp.module.settings import SettingError
from robbie_mp.run.live_runs import NoSuchRun
from tests._support.robot import PROJECT, Robot, wait_until
from tests._support.zoo_modules import Add

PROFILE = """
modules:
  listener: {class: "zoo.modules:Listener", queue: {messages: 100000}}
  pulse: {class: "zoo.modules:Pulse", settings: {period_s: 0.02, burst: 1}}
  tunable: {class: "zoo.modules:Tunable", settings: {gain: 2}}
  adder: {class: "zoo.modules:Adder"}
tools: {count: 3}
"""


def attached(robot: Robot) -> list[str]:
    return [name for name in robot.top() if name.startswith("~")]


@pytest.fixture
def run(robot: Robot) -> Iterator[AttachedRun]:
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(lambda modules: modules["listener"]["handled"] > 2)
    with robbie_mp.attach(robot.known_run().run_id) as run:
        yield run
    wait_until(lambda: all(thread.name != "robbie listen" for thread in threading.enumerate()))


@pytest.mark.slow
def test_script_does_everything_on_one_robot(robot: Robot, run: AttachedRun) -> None:
    listens(run)
    listens_slowly(run)
    frees_its_place(robot, run)
    says_why_nothing_comes(run)
    publishes(robot, run)
    reads_and_changes_parameters(run)
    calls(robot, run)
    is_refused_in_a_fork(run)
    assert run.modules == dict.fromkeys(("listener", "pulse", "tunable", "adder"), "RUNNING")
    notices_the_end(robot, run)


def listens(run: AttachedRun) -> None:
    numbers, kept = [], []
    for command in run.listen(DriveCommand, "wheels", timeout_s=20):
        numbers.append(command.header.stamp.sec)
        kept.append(command)
        if len(numbers) == 20:
            break
    assert numbers == list(range(numbers[0], numbers[0] + 20))
    assert [command.header.stamp.sec for command in kept] == numbers, "copies stay valid"
    assert run.latest(DriveCommand).header.stamp.sec > numbers[-1]
    with run.listen(DriveCommand, duration_s=1.0) as listener:
        heard = list(listener)
        assert heard
        assert listener.envelope.sender == "pulse"


def listens_slowly(run: AttachedRun) -> None:
    """A loop that stands still for longer than a tool may, and a queue that is too short for it."""
    with run.listen(DriveCommand, max_waiting=5) as listener:
        first = next(listener).header.stamp.sec
        until_s = time.monotonic() + 1.5
        wait_until(lambda: time.monotonic() > until_s)
        later = [next(listener).header.stamp.sec for _ in range(5)]
        assert later == list(range(later[0], later[0] + 5)), "it was not detached"
        wait_until(lambda: listener.missed > 0)
        assert later[0] - first - 1 == pytest.approx(listener.missed, abs=2)


def frees_its_place(robot: Robot, run: AttachedRun) -> None:
    """However a loop ends: by Ctrl-C, by an error in it, or because a notebook has forgotten it."""
    wait_until(lambda: not attached(robot))
    listener = run.listen(Image)  # nobody publishes it
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a parallel test run ignores it
    try:
        threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            next(listener)
    finally:
        signal.signal(signal.SIGINT, before)
    wait_until(lambda: not attached(robot))
    forgotten: Any = run.listen(DriveCommand)
    next(forgotten)
    wait_until(lambda: len(attached(robot)) == 1)
    del forgotten
    gc.collect()
    wait_until(lambda: not attached(robot))
    killed = subprocess.Popen(
        [sys.executable, "-c", KILLED, run.run_id], cwd=PROJECT, stdout=subprocess.PIPE, env=dict(os.environ)
    )
    assert killed.stdout is not None
    assert killed.stdout.readline() == b"hears\n"
    wait_until(lambda: len(attached(robot)) == 1)
    killed.kill()
    killed.wait(timeout=20)
    killed.stdout.close()
    wait_until(lambda: not attached(robot))


KILLED = """
import sys, robbie_mp
from robbie_mp.messages import DriveCommand
run = robbie_mp.attach(sys.argv[1])
for command in run.listen(DriveCommand):
    print("hears", flush=True)
"""


class Newer(Message, name="robbie_msgs/msg/DriveCommand", version=99):
    """A version that the robot does not have."""

    speed: float64


def says_why_nothing_comes(run: AttachedRun) -> None:
    for kind, topic, why in (
        (Image, "", "no Image within 0.05 s; no module publishes it"),
        (DriveCommand, "arm", "nothing is published on topic 'arm', but on 'wheels'"),
        (Newer, "", f"the robot has version {DriveCommand.version}, this program version 99"),
    ):
        with pytest.raises(NothingHeard) as caught:
            run.latest(kind, topic, timeout_s=0.05)
        assert why in str(caught.value)


def publishes(robot: Robot, run: AttachedRun) -> None:
    for number in (1000001, 1000002):
        assert run.publish(DriveCommand(header=Header(stamp=Time(sec=number))), "other")
    with pytest.raises(IllFormed, match="expected a finite number"):
        run.publish(PoseStamped(pose=Pose(position=Point(x=math.nan))), "goal")
    wait_until(lambda: 1000002 in robot.journal("listener"))


def reads_and_changes_parameters(run: AttachedRun) -> None:
    parameters = run.parameters
    assert (parameters["tunable.gain"], parameters["pulse.burst"]) == (2, 1)
    assert "tunable.gain" in dict(parameters)
    assert parameters.set("tunable.gain", 5) == "5"
    assert parameters["tunable.gain"] == 5
    with pytest.raises(SettingError, match="13 brings bad luck"):
        parameters.set("tunable.gain", 13)
    with pytest.raises(NotChangeable, match="set it in the profile"):
        parameters.set("pulse.burst", 3)
    with pytest.raises(NotChangeable, match="did you mean 'gain'"):
        parameters["tunable.gian"]


def calls(robot: Robot, run: AttachedRun) -> None:
    wait_until(lambda: len(attached(robot)) <= 1)
    assert run.call(Add(a=2, b=3), topic="sums").total == 5
    with pytest.raises(CallRefused, match="-1 is negative"):
        run.call(Add(a=-1), topic="sums")
    with pytest.raises(NoServer):
        run.call(Add())
    wait_until(lambda: len(attached(robot)) <= 1)  # each call takes one of three places, and publishing, too
    os.kill(robot.top()["adder"]["pid"], signal.SIGSTOP)
    with pytest.raises(CallTimedOut):
        run.call(Add(a=1), topic="sums", timeout_s=0.2)
    os.kill(robot.top()["adder"]["pid"], signal.SIGCONT)


def is_refused_in_a_fork(run: AttachedRun) -> None:
    with run.listen(DriveCommand) as listener:
        process = multiprocessing.get_context("fork").Process(target=use_in_a_fork, args=(run, listener))
        process.start()
        process.join(20)
        assert process.exitcode == 0
        assert next(listener)


def use_in_a_fork(run: AttachedRun, listener: Any) -> None:
    for use in (lambda: next(listener), lambda: run.publish(DriveCommand()), lambda: run.listen(Image)):
        with pytest.raises(NotAttached, match="forked"):
            use()


def notices_the_end(robot: Robot, run: AttachedRun) -> None:
    ended: list[str] = []

    def listen() -> None:
        ended.extend(command.header.frame_id for command in run.listen(DriveCommand))
        ended.append("ended")

    thread = threading.Thread(target=listen)
    thread.start()
    wait_until(lambda: bool(ended))
    robot.command("stop")
    thread.join(20)
    assert ended[-1] == "ended"
    wait_until(lambda: not run_is_there(run))
    for use in (lambda: run.modules, lambda: run.publish(DriveCommand())):
        with pytest.raises(RunEnded):
            use()
    run.close()
    with pytest.raises(NotAttached, match="closed"):
        run.listen(DriveCommand)


def run_is_there(run: AttachedRun) -> bool:
    try:
        return bool(run.modules)
    except RunEnded:
        return False


def test_without_a_robot_the_error_says_what_to_do(robot: Robot) -> None:
    with pytest.raises(NoSuchRun, match="no run on this machine; start one with `robbie run PROFILE`"):
        robbie_mp.attach()
