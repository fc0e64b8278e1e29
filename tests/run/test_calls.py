"""Calls in live robots: whatever is killed, each ends exactly once, and no handler gets a request twice."""

import os
import signal
import time
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from tests._support.robot import Ended, Robot, wait_until

pytestmark = pytest.mark.slow

MODULES = '''
import os
import time

from robbie_mp import Module, Reply, Request, setting, uint32


class Doubled(Reply, name="zoo_msgs/srv/Double_Response"):
    number: uint32


class Double(Request[Doubled], name="zoo_msgs/srv/Double_Request"):
    number: uint32


class Journal:
    """Writes one line with one system call."""

    def __init__(self, module):
        path = module.output_directory / f"{module.name}.calls"
        self.file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def write(self, *words):
        os.write(self.file, (" ".join(map(str, words)) + "\\n").encode())


class Asker(Module):
    """Calls in each tick, while it may."""

    period_s: float = setting(0.01, "time between calls")
    timeout_s: float = setting(100.0, "timeout of calls")
    ahead: int = setting(20, "calls that may wait")
    count: int = setting(1000000, "calls to make")

    def setup(self):
        self.journal = Journal(self)
        self.number = (self.restored or 0)
        self.journal.write("begin", self.number)
        self.waiting = 0

    def tick(self):
        if self.waiting >= self.ahead or self.number >= self.count:
            return
        self.number += 1
        self.checkpoint(self.number)
        self.waiting += 1
        number = self.number
        self.journal.write("call", number)
        self.call(
            Double(number=number),
            lambda reply: self.end(number, "reply", reply.number),
            lambda error: self.end(number, "error", type(error).__name__),
            timeout_s=self.timeout_s,
        )

    def end(self, number, *words):
        self.waiting -= 1
        self.journal.write("end", number, *words)
        self.status = f"{number} {' '.join(map(str, words))}"


class Doubler(Module):
    """Doubles numbers; hangs at one of them the first time."""

    hangs_at: int = setting(0, "number at which the handler takes long")

    def setup(self):
        self.journal = Journal(self)
        self.serve(Double, self.on_double)

    def on_double(self, request):
        self.journal.write("handle", request.call, request.number)
        if request.number == self.hangs_at:
            self.status = "hangs"
            time.sleep(1000)
        return Doubled(number=2 * request.number)


class Idle(Module):
    """Serves nothing."""
'''


def write(robot: Robot, profile: str) -> None:
    (robot.folder / "zoo" / "calls.py").write_text(MODULES)
    robot.write_profile(profile)


def lines(robot: Robot, name: str) -> Iterator[list[str]]:
    file = robot.output / f"{name}.calls"
    for line in file.read_text().splitlines() if file.exists() else []:
        yield line.split()


class Book(NamedTuple):
    """What a client's journal says about its calls."""

    ends: Counter[int]
    kinds: Counter[str]
    open: set[int]
    """Calls of the last process without an end."""

    @classmethod
    def read(cls, robot: Robot, name: str = "asker") -> "Book":
        ends: Counter[int] = Counter()
        kinds: Counter[str] = Counter()
        waiting: set[int] = set()
        for kind, number, *words in lines(robot, name):
            if kind == "begin":
                waiting.clear()
            elif kind == "call":
                waiting.add(int(number))
            else:
                ends[int(number)] += 1
                assert int(number) in waiting, f"call {number} has ended before, or is of a dead process"
                waiting.remove(int(number))
                kinds[words[-1] if words[0] == "error" else "reply"] += 1
                if words[0] == "reply":
                    assert int(words[1]) == 2 * int(number)
        return cls(ends, kinds, waiting)


def handled(robot: Robot, name: str = "doubler") -> Counter[tuple[str, str]]:
    return Counter((call, number) for _, call, number in lines(robot, name))


def kill(robot: Robot, name: str) -> None:
    """Kill a module's process, or the core, and wait for the next one."""
    before = robot.top()[name]
    os.kill(before["pid"], signal.SIGKILL)
    robot.until(lambda modules: modules[name]["pid"] != before["pid"] and modules[name]["state"] == "RUNNING")


def until_more(robot: Robot, replies: int) -> None:
    """Wait until the asker got more replies."""
    goal = Book.read(robot).kinds["reply"] + replies
    wait_until(lambda: Book.read(robot).kinds["reply"] >= goal)


ROBOT = """
modules:
  doubler:
    class: zoo.calls:Doubler
    settings: {hangs_at: %d}
    restart: {max_restarts: 50}
    handler_deadline_s: 1000.0
  asker: {class: "zoo.calls:Asker", settings: {count: %d, timeout_s: %f}, restart: {max_restarts: 50}}
core: {restart: {max_restarts: 50}}
"""


def test_every_call_ends_once_whatever_is_killed(robot: Robot) -> None:
    write(robot, ROBOT % (0, 1_000_000, 100.0))
    process = robot.start()
    robot.until(lambda modules: modules["asker"]["status"] != "")
    for _ in range(3):
        for name in ("doubler", "asker", "core"):
            kill(robot, name)
            until_more(robot, 30)
    process.terminate()
    ended = Ended.wait_for(process)
    assert ended.exit_code == 0, ended.stderr
    book = Book.read(robot)
    assert max(book.ends.values()) == 1
    assert set(book.kinds) <= {"reply", "ServerDied"}
    assert book.kinds["ServerDied"] <= 3, "at most the request that it was handling"
    assert max(handled(robot).values()) == 1


def test_death_in_a_handler_is_told_at_once_and_the_next_process_serves_the_rest(robot: Robot) -> None:
    write(robot, ROBOT % (5, 30, 100.0))
    process = robot.start()
    robot.until(lambda modules: modules["doubler"]["status"] == "hangs")
    wait_until(lambda: len(Book.read(robot).open) >= 20)
    since_s = time.monotonic()
    kill(robot, "doubler")
    wait_until(lambda: len(Book.read(robot).ends) == 30)
    assert time.monotonic() - since_s < 50.0, "long before the timeout"
    process.terminate()
    Ended.wait_for(process)
    assert Book.read(robot).kinds == {"reply": 29, "ServerDied": 1}
    assert set(handled(robot).values()) == {1}


def test_missing_and_stopped_servers_are_told_at_once(robot: Robot) -> None:
    write(robot, ROBOT % (3, 1_000_000, 100.0))
    process = robot.start()
    robot.until(lambda modules: modules["doubler"]["status"] == "hangs")
    wait_until(lambda: len(Book.read(robot).open) >= 5)
    stopped = robot.command("module", "stop", "doubler")
    assert stopped.returncode == 0, stopped.stderr
    wait_until(lambda: Book.read(robot).kinds["NoServer"] >= 50)
    assert robot.command("module", "start", "doubler").returncode == 0
    until_more(robot, 5)
    process.terminate()
    Ended.wait_for(process)
    assert set(Book.read(robot).kinds) == {"reply", "NoServer"}


def test_second_server_of_a_request_is_refused_at_the_start(robot: Robot) -> None:
    write(
        robot,
        """
modules:
  asker: {class: "zoo.calls:Asker"}
  first: {class: "zoo.calls:Doubler"}
  second: {class: "zoo.calls:Doubler", restart: {policy: never}}
""",
    )
    process = robot.start()
    robot.until(lambda modules: modules["second"]["state"] == "FAILED")
    until_more(robot, 5)
    process.terminate()
    Ended.wait_for(process)
    assert "ServedTwice: second and first both serve zoo_msgs/srv/Double_Request" in robot.log("second")
    assert not handled(robot, "second")
