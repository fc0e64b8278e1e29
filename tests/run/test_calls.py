"""Calls in live robots: whatever is killed, each ends exactly once, and no handler gets a request twice."""

import os
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from tests._support.robot import COMMAND, LIMIT_S, Ended, Robot, wait_until

pytestmark = pytest.mark.slow

MODULES = '''
import os
import time

from robbie_mp import CallRefused, Feedback, Goal, Module, Reply, Request, Result, setting, uint32


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


class Counted(Feedback, name="zoo_msgs/action/Count_Feedback"):
    number: uint32


class Finished(Result, name="zoo_msgs/action/Count_Result"):
    number: uint32


class Count(Goal[Counted, Finished], name="zoo_msgs/action/Count_Goal"):
    first: uint32
    last: uint32


class Abacus(Module):
    """Counts; its goals survive it, if it may remember them."""

    period_s = 0.05
    remembers: bool = setting(False, "continue goals after a restart")

    def setup(self):
        self.active, self.number = None, 0
        if self.restored is not None and self.remembers:
            self.active = self.resume_goal(Count, self.restored["goal"])
            self.number = self.restored["number"]
        self.serve_goals(Count, self.on_goal)

    def on_goal(self, active):
        if active.goal.last < active.goal.first:
            raise CallRefused("counts only forwards")
        if self.active is not None and self.active.is_active:
            self.active.preempt("another goal came")
        self.active, self.number = active, active.goal.first

    def tick(self):
        if self.active is None or not self.active.is_active:
            self.checkpoint(None)
            return
        self.checkpoint({"goal": self.active.memory, "number": self.number})
        self.active.feedback(Counted(number=self.number))
        if self.number >= self.active.goal.last:
            self.active.succeed(Finished(number=self.number))
        self.number += 1


class Patient(Module):
    """Calls, and sends goals: one is cancelled, one takes too long. Then it has no ticks any more."""

    period_s = 0.3

    def setup(self):
        self.journal = Journal(self)

    def tick(self):
        self.period_s = None
        self.call(Double(number=2), self.on_end, self.on_end)
        self.call(Double(number=2), self.on_end, self.on_end, topic="nowhere")
        self.sent = self.send_goal(Count(first=1, last=1000), self.on_end, self.on_cancelled, self.on_counted)

    def on_counted(self, counted):
        self.on_end(counted)
        if counted.number == 3:
            self.sent.cancel("enough")

    def on_cancelled(self, error):
        self.on_end(error)
        self.send_goal(Count(first=1, last=1000), self.on_end, self.on_end, self.on_end, timeout_s=0.5)

    def on_end(self, end):
        self.journal.write(self.clock.monotonic_ns(), type(end).__name__)


class Pupil(Module):
    """Sends one goal."""

    last: int = setting(40, "number to count to")
    period_s = 0.02

    def setup(self):
        self.journal = Journal(self)
        self.sent = None

    def tick(self):
        if self.sent is None:
            goal = Count(first=1, last=self.last)
            self.sent = self.send_goal(goal, self.on_end, self.on_end, self.on_number)

    def on_number(self, counted):
        self.journal.write("feedback", counted.number)
        self.status = str(counted.number)

    def on_end(self, end):
        self.journal.write("end", type(end).__name__, end)
        self.status = type(end).__name__
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
    Ended.in_order(process, signal.SIGTERM)
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


PUPILS = """
modules:
  abacus: {class: "zoo.calls:Abacus", settings: {remembers: %s}, restart: {max_restarts: 50}}
  pupil: {class: "zoo.calls:Pupil", settings: {last: %d}}
core: {restart: {max_restarts: 50}}
"""


def counted(status: str) -> int:
    """How far the pupil is; it may be beyond a number when somebody looks."""
    return int(status) if status.isdigit() else 0


def pupils(robot: Robot, remembers: str, last: int) -> None:
    """Start to count, and wait until the third number has come."""
    write(robot, PUPILS % (remembers, last))
    robot.start()
    robot.until(lambda modules: counted(modules["pupil"]["status"]) >= 3)


def ends(robot: Robot) -> list[str]:
    return [words[1] for words in lines(robot, "pupil") if words[0] == "end"]


def numbers(robot: Robot) -> list[int]:
    return [int(words[1]) for words in lines(robot, "pupil") if words[0] == "feedback"]


def test_goal_ends_once_when_its_server_dies(robot: Robot) -> None:
    pupils(robot, "false", 1_000_000)
    kill(robot, "core")
    before = numbers(robot)[-1]
    wait_until(lambda: numbers(robot)[-1] > before + 2)
    assert not ends(robot)
    kill(robot, "abacus")
    robot.until(lambda modules: modules["pupil"]["status"] == "ServerDied")
    assert ends(robot) == ["ServerDied"]


def test_goal_that_its_server_remembers_survives_all_kills(robot: Robot) -> None:
    pupils(robot, "true", 60)
    kill(robot, "abacus")
    kill(robot, "core")
    robot.until(lambda modules: modules["pupil"]["status"] == "Finished")
    assert ends(robot) == ["Finished"]
    assert sorted(set(numbers(robot))) == list(range(1, 61))


def test_goals_from_the_command_line(robot: Robot) -> None:
    pupils(robot, "false", 1_000_000)
    done = robot.command("call", "Count", "{first: 1, last: 3}", "--json")
    assert done.stdout.splitlines() == [f'{{"number": {number}}}' for number in (1, 2, 3, 3)], done.stderr
    assert ends(robot) == ["GoalPreempted"]
    refused = robot.command("call", "zoo_msgs/Count", "{first: 2, last: 1}")
    assert (refused.returncode, refused.stderr) == (1, "counts only forwards\n")
    counting = subprocess.Popen(
        [*COMMAND, "call", "Count", "{first: 1, last: 1000000}", "--json"],
        cwd=robot.folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert counting.stdout is not None
    assert counting.stdout.readline() == '{"number": 1}\n'
    counting.send_signal(signal.SIGINT)
    stdout, stderr = counting.communicate(timeout=LIMIT_S)
    assert counting.returncode == 1, stdout
    assert stderr == "(cancelling; Ctrl-C again leaves the goal alone)\nCtrl-C\n"


LOCKSTEP = """
modules:
  time:
    class: robbie_mp.logs.simulated_time:SimulatedTime
    settings: {start_s: 1000.0, duration_s: 1.5, rate: null}
    ends_run: true
  doubler: {class: "zoo.calls:Doubler"}
  abacus: {class: "zoo.calls:Abacus"}
  patient: {class: "zoo.calls:Patient"}
clock: {source: time, lockstep: true}
core: {deadline_s: 60.0}
"""


def test_calls_and_goals_in_lockstep_end_at_the_same_time_in_each_run(robot: Robot) -> None:
    write(robot, LOCKSTEP)
    courses = []
    for number in range(2):
        robot.output = robot.folder / f"out{number}"
        ended = robot.run()
        assert ended.exit_code == 0, ended.stderr
        courses.append(list(lines(robot, "patient")))
    assert courses[0] == courses[1]
    kinds = [kind for _, kind in courses[0]]
    assert kinds[:2] == ["NoServer", "Doubled"]
    cancelled = kinds.index("GoalCancelled")
    assert kinds[2:cancelled] == ["Counted"] * 3
    assert kinds[cancelled + 1 :].count("Counted") >= 9
    assert kinds[-1] == "CallTimedOut"
    assert int(courses[0][0][0]) == 1_000_000_000_000
    assert int(courses[0][-1][0]) - int(courses[0][cancelled][0]) == pytest.approx(0.5e9, abs=0.06e9)
