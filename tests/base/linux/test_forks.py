"""A module that forks keeps its place in the run; the forked process has none."""

import json

import pytest

from tests._support.robot import Robot, wait_until

pytestmark = pytest.mark.slow

MODULES = '''
import json
import multiprocessing
import os
import sys
import time
import numpy as np

from robbie_mp import Header, Time
from robbie_mp.messages import DriveCommand, Image
from robbie_mp import Module, setting


def command(number):
    return DriveCommand(header=Header(stamp=Time(sec=number)))


class Forking(Module):
    """Publishes numbered messages, and forks in the midst of them."""

    period_s = 0.005
    count: int = setting(100, "messages")
    way: str = setting("process", "how it forks")

    def setup(self):
        self.number = 0
        self.subscribe(DriveCommand, self.on_command)

    def on_command(self, command):
        if command.header.stamp.sec == 50 and self.way == "returns from a handler":
            os.fork()
        if command.header.stamp.sec == 50 and self.way == "exits in a handler":
            if os.fork() == 0:
                sys.exit(0)
        if command.header.stamp.sec == 50 and self.way == "fails in a handler":
            if os.fork() == 0:
                raise ZeroDivisionError("in the fork")

    def tick(self):
        if self.number == self.count:
            if self.outstanding == 0:
                self.stop()
            return
        self.publish(command(self.number))
        self.number += 1
        if self.number == 30 and self.way == "process":
            process = multiprocessing.get_context("fork").Process(target=self.try_everything)
            process.start()
            process.join()
        if self.number == 30 and self.way == "terminate":
            process = multiprocessing.get_context("fork").Process(target=time.sleep, args=(1000,))
            process.start()
            time.sleep(0.1)
            process.terminate()
            process.join(5)
            self.status = f"ended by {process.exitcode}"

    def try_everything(self):
        said = {}
        for name, use in {
            "publish": lambda: self.publish(command(1000)),
            "publish_encoded": lambda: self.publish_encoded("a/msg/B", 1, b"\\0\\1\\0\\0data"),
            "loan": lambda: self.loan(Image, data=10).__enter__(),
            "new topic": lambda: self.publish(command(1000), topic="other"),
            "subscribe": lambda: self.subscribe(Image, print),
            "outstanding": lambda: self.outstanding,
            "wake_after_freed": lambda: self.wake_after_freed(1),
            "checkpoint": lambda: self.checkpoint({"number": 1000}),
            "status": lambda: setattr(self, "status", "forked"),
            "show_state": lambda: self.show_state("FORKED"),
        }.items():
            try:
                use()
            except Exception as error:
                said[name] = type(error).__name__
            else:
                said[name] = "allowed"
        (self.output_directory / "said.json").write_text(json.dumps(said))
        self.log.warning("said by the fork")
        self.publish(command(1000))

    def teardown(self):
        with open(self.output_directory / "teardowns", "a") as file:
            file.write(f"{os.getpid()}\\n")


class Listener(Module):
    def setup(self):
        self.subscribe(DriveCommand, self.on_command)

    def on_command(self, command):
        with open(self.output_directory / "listener.journal", "a") as journal:
            journal.write(f"{command.header.stamp.sec}\\n")
'''

PROFILE = """
modules:
  listener: {class: "zoo.forking:Listener"}
  forking: {class: "zoo.forking:Forking", ends_run: true, settings: {way: "%s"}, restart: {policy: never}}
"""


def run(robot: Robot, way: str) -> dict[str, object]:
    """Run it to its end; check that nothing of the module's own is lost."""
    (robot.folder / "zoo" / "forking.py").write_text(MODULES)
    robot.write_profile(PROFILE % way)
    ended = robot.run()
    assert robot.journal("listener") == list(range(100)), "a message is lost, doubled or changed"
    assert ended.exit_code == 0, robot.log("forking")
    forking: dict[str, object] = ended.modules["forking"]
    assert forking["published"] == 100
    assert ended.modules["forking"]["subscriptions"][0]["delivered"] == 100
    assert len((robot.output / "teardowns").read_text().split()) == 1, "the fork has torn the module down"
    return forking


def test_forked_process_is_refused_whatever_it_does_and_the_module_loses_nothing(robot: Robot) -> None:
    forking = run(robot, "process")
    said = json.loads((robot.output / "said.json").read_text())
    assert set(said.values()) == {"ForkedProcess"}, said
    assert forking["status"] == ""
    log = robot.log("forking")
    assert "said by the fork" in log
    assert "was forked by a module and is not part of the run" in log
    assert 'get_context("spawn")' in log


def test_fork_that_returns_from_a_handler_is_ended_and_told(robot: Robot) -> None:
    run(robot, "returns from a handler")
    wait_until(lambda: "ERROR a process that this module forked ended with" in robot.log("forking"))


def test_fork_that_exits_in_a_handler_just_ends(robot: Robot) -> None:
    run(robot, "exits in a handler")
    assert "forked" not in robot.log("forking")


def test_fork_that_fails_is_told_apart_from_the_module(robot: Robot) -> None:
    run(robot, "fails in a handler")
    log = robot.log("forking")
    assert "a process that this module forked ended with ZeroDivisionError: in the fork" in log
    assert "CRITICAL" not in log


def test_forked_process_ends_by_the_signal_that_asks_it_to(robot: Robot) -> None:
    """As `Process.terminate` and pools require; the module's signal handler must not apply."""
    assert run(robot, "terminate")["status"] == "ended by -15"
