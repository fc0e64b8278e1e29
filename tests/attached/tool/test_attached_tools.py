"""Tools are killed, stopped and attach at bad times, and no module loses a message."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest

from robbie_mp import Header, Time
from robbie_mp.attached.tool.tool import Detached, Received, Tool
from robbie_mp.bus.transport.records import ANY_VERSION, Outbound
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.cli.runs import live_runs
from robbie_mp.messages import DriveCommand
from robbie_mp.run.control import ControlRefused, control
from robbie_mp.run.run_directory import KnownRun
from tests._support.robot import COMMAND, Ended, Robot, kill, wait_until

PROFILE = """
modules:
  listener:
    class: zoo.modules:Listener
    queue: {messages: 100000}
  by_pattern:
    class: zoo.modules:PatternListener
    queue: {messages: 100000}
  pulse: {class: "zoo.modules:Pulse"}
core: {deadline_s: 60.0, ring_records: 16384}
tools: {count: 1, messages: 40}
"""
TOOL = "~tool1"
EACH = 60
"""Number of messages that show that the tool works again."""


class Echo:
    """`robbie echo` in a separate process that prints into a file."""

    def __init__(self, folder: Path, run_id: str, name: str):
        self.output = folder / f"{name}.jsonl"
        self.notes = folder / f"{name}.err"
        command = [*COMMAND, "echo", "DriveCommand", "--run", run_id, "--topic", "wheels", "--json"]
        with self.output.open("wb") as output, self.notes.open("wb") as notes:
            self.process = subprocess.Popen(command, stdout=output, stderr=notes)

    def numbers(self) -> list[int]:
        """The complete lines that it has printed."""
        whole, _, _ = self.output.read_text().rpartition("\n")
        return [json.loads(line)["message"]["header"]["stamp"]["sec"] for line in whole.splitlines()]

    def wait_for_more(self) -> None:
        """Wait until it has printed some more messages."""
        before = len(self.numbers())
        wait_until(lambda: len(self.numbers()) >= before + EACH)

    def printed_and_missed(self) -> tuple[int, int]:
        """Its output at the end."""
        printed, missed = self.notes.read_text().splitlines()[-1].strip("()").split(", ")
        return int(printed.removeprefix("printed ")), int(missed.removeprefix("missed "))


@pytest.fixture
def echoes() -> Iterator[list[Echo]]:
    started: list[Echo] = []
    yield started
    for echo in started:
        if echo.process.poll() is None:
            echo.process.kill()
        echo.process.wait(10)


def let_all_be_handled(robot: Robot) -> None:
    """End the flood first, because a stopped module does not handle the messages that still wait."""
    control(robot.known_run().folder, "stop", "pulse")
    published = robot.top()["pulse"]["published"]
    robot.until(
        lambda modules: modules["listener"]["handled"] == modules["by_pattern"]["handled"] == published
    )


@pytest.mark.slow
def test_modules_lose_no_message_while_tools_attach_detach_die_and_stall(
    robot: Robot, echoes: list[Echo]
) -> None:
    robot.write_profile(PROFILE)
    process = robot.start()
    robot.until(lambda modules: modules["listener"]["handled"] > 0)
    (run,) = live_runs()

    def start(name: str) -> Echo:
        echoes.append(Echo(robot.folder, run.run_id, name))
        return echoes[-1]

    # Killed: its place is free again.
    killed = start("killed")
    killed.wait_for_more()
    refused = robot.command("echo", "DriveCommand", "--run", run.run_id)
    assert refused.returncode == 1
    assert refused.stderr.startswith(
        "no slot is free for robbie echo robbie_msgs/msg/DriveCommand: tools.count"
    )
    kill(killed.process.pid)
    robot.until(lambda modules: TOOL not in modules)

    # It attaches while the core stands still; then the core is killed.
    figures = robot.until(lambda modules: modules["core"]["pid"] != 0)
    os.kill(figures["core"]["pid"], signal.SIGSTOP)
    watching = start("watching")
    robot.until(lambda modules: TOOL in modules)
    assert watching.numbers() == []
    os.kill(figures["core"]["pid"], signal.SIGCONT)
    watching.wait_for_more()
    kill(figures["core"]["pid"])
    robot.until(lambda modules: modules["core"]["restarts"] == 1 and modules["core"]["state"] == "RUNNING")
    watching.wait_for_more()

    # Stopped in a flood: it is detached, and attaches again by itself.
    os.kill(watching.process.pid, signal.SIGSTOP)
    robot.until(lambda modules: TOOL not in modules)
    handled = robot.top()["listener"]["handled"]
    robot.until(lambda modules: modules["listener"]["handled"] > handled + EACH)
    os.kill(watching.process.pid, signal.SIGCONT)
    watching.wait_for_more()
    assert "missed" in watching.notes.read_text()

    let_all_be_handled(robot)
    ended = Ended.in_order(process)
    assert watching.process.wait(30) == 0
    assert "(the run has ended)" in watching.notes.read_text()

    # No module has lost anything.
    (published,) = robot.journal("pulse")
    assert robot.journal("listener") == robot.journal("by_pattern") == list(range(published))
    pulse, listener = ended.modules["pulse"], ended.modules["listener"]
    assert (pulse["published"], pulse["refused"], pulse["restarts"]) == (published, 0, 0)
    assert listener["dropped"] == listener["lost"] == 0
    assert TOOL not in ended.modules

    # The printed messages are in order, and the gaps are those that echo reports.
    for echo in (killed, watching):
        assert echo.numbers() == sorted(set(echo.numbers()))
    numbers = watching.numbers()
    gaps = numbers[-1] - numbers[0] + 1 - len(numbers)
    printed, missed = watching.printed_and_missed()
    assert printed == len(numbers)
    assert gaps > EACH
    # While it is detached, a message that is just being routed may be counted wrongly.
    attached = 1 + watching.notes.read_text().count("missed")
    assert abs(missed - gaps - (published - 1 - numbers[-1])) <= 2 * attached


@pytest.mark.slow
def test_modules_lose_no_message_while_they_do_not_run(robot: Robot) -> None:
    """As on a machine that is so busy that they get no processor time for seconds."""
    robot.write_profile(PROFILE.replace('modules:Pulse"', 'modules:Pulse", settings: {burst: 200}'))
    process = robot.start()
    figures = robot.until(lambda modules: modules["listener"]["handled"] > 0)
    standing = [figures[name]["pid"] for name in ("listener", "by_pattern")]
    for pid in standing:
        os.kill(pid, signal.SIGSTOP)
    robot.until(lambda modules: modules["pulse"]["outstanding"] >= 2000)
    ticks = robot.top()["pulse"]["ticks"]
    robot.until(lambda modules: modules["pulse"]["ticks"] > ticks + 20)
    for pid in standing:
        os.kill(pid, signal.SIGCONT)
    let_all_be_handled(robot)
    ended = Ended.in_order(process)
    assert all(ended.modules[name]["dropped"] == 0 for name in ("listener", "by_pattern"))
    assert ended.modules["pulse"]["refused"] == 0


def attach(run: KnownRun, purpose: str) -> Tool:
    """Attach as soon as a slot is free: that of a detached tool is reclaimed a little later."""
    found: list[Tool] = []

    def is_attached() -> bool:
        with suppress(ControlRefused):
            found.append(Tool(run, purpose))
        return bool(found)

    wait_until(is_attached)
    return found[0]


def take_one_by_pattern(run: KnownRun) -> Received:
    """Attach and take a message; repeat if this process stood still and was detached."""
    while True:
        with closing(attach(run, "a tool that takes what it finds")) as curious:
            curious.subscribe("*/Drive*", ANY_VERSION, "wh*")
            curious.subscribe("robbie_msgs/*", ANY_VERSION, "*s")
            curious.ready()
            with suppress(Detached):
                assert curious.wait_for(lambda: curious.is_subscribed() and curious.counts()[1] > 0, 60.0)
                while (received := curious.take()) is None:
                    curious.wait(0.005)  # the core counts it before it arrives
                return received


def names_of(run: KnownRun) -> set[str]:
    """The names of a run in /dev/shm."""
    return {str(path) for path in SHARED_MEMORY.rglob("*") if run.run_id in str(path)}


@pytest.mark.slow
def test_stalled_or_misbehaving_tool_is_detached_and_leaves_nothing(robot: Robot) -> None:
    robot.write_profile(PROFILE.replace("count: 1", "count: 2"))
    process = robot.start()
    robot.until(lambda modules: modules["listener"]["handled"] > 0)
    (run,) = live_runs()
    before = names_of(run)

    publisher = attach(run, "a tool that publishes and leaves")
    publisher.ready()
    assert publisher.publish(DriveCommand(header=Header(stamp=Time(sec=1_000_000))), "wheels")
    topics = json.loads(robot.command("list", "topics", "--run", run.run_id, "--json").stdout)
    assert [row["subscribers"] for row in topics if row["topic"] == "wheels"] == [["listener", "by_pattern"]]
    publisher.close()
    wait_until(lambda: 1_000_000 in robot.journal("listener"))
    robot.until(lambda modules: TOOL not in modules)

    idle = attach(run, "a tool that has nothing to do")
    idle.ready()
    # Its slot is the first one, unless that of the tool before it was not free again yet.
    own, other = (TOOL, "~tool2") if TOOL in robot.top() else ("~tool2", TOOL)
    received = take_one_by_pattern(run)
    assert (received.type_name, received.version) == (DriveCommand.type_name, DriveCommand.version)
    assert (received.topic, received.sender) == ("wheels", "pulse")
    robot.until(lambda modules: other not in modules)
    still = attach(run, "a tool that stands still")
    still.subscribe(DriveCommand.type_name, DriveCommand.version, "wheels")
    still.ready()
    robot.until(lambda modules: other not in modules)
    with pytest.raises(Detached):
        still.take()  # even though its ring is full of messages: their memory is used again
    with pytest.raises(Detached, match="it has not taken its messages for 1 s"):
        still.wait_for(lambda: False, 20.0)  # it learns the reason a little after its row is withdrawn
    still.close()
    idle.wait(0.01)
    assert own in robot.top()
    idle.close()
    robot.until(lambda modules: own not in modules)

    hostile = attach(run, "a hostile tool")
    hostile._endpoint.send(Outbound.MODULE_GONE, 1)  # which only the supervisor can report
    with pytest.raises(Detached, match="a hostile tool: the core refused its records"):
        hostile.wait_for(lambda: False, 20.0)
    hostile.close()
    handled = robot.until(lambda modules: not {own, other} & set(modules))["listener"]["handled"]
    robot.until(lambda modules: modules["listener"]["handled"] > handled + EACH)
    wait_until(lambda: names_of(run) <= before)

    ended = Ended.in_order(process)
    assert all(ended.modules[name]["restarts"] == 0 for name in ("listener", "pulse", "core"))
