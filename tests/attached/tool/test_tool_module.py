"""A module that runs as a tool handles, publishes, ticks, and attaches again after a detach."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import pytest

from robbie_mp import Envelope, MessageHandling, Module
from robbie_mp.attached.tool import message_stream, tool, tool_bus
from robbie_mp.attached.tool.message_stream import MessageStream
from robbie_mp.attached.tool.tool import Detached, RunEnded, Tool
from robbie_mp.attached.tool.tool_bus import ToolBus
from robbie_mp.attached.tool.tool_module import run_as_tool
from robbie_mp.messages import DriveCommand, EmergencyStop, Image
from robbie_mp.run.control import ControlRefused
from robbie_mp.run.run_directory import KnownRun
from tests._support.robot import Ended, Robot, is_running, wait_until

PROFILE = """
modules:
  base: {class: "zoo.modules:StandingBase"}
  pulse: {class: "zoo.modules:Pulse"}
tools: {count: 1}
"""
TOOL = "~tool1"


class Visitor(Module):
    """Stops the base as soon as it receives the pulse, and stands still once."""

    period_s = 0.01
    is_detached: ClassVar[Callable[[], bool]]

    def setup(self) -> None:
        self.envelopes: list[Envelope] = []
        self.heard: list[int] = []
        self.patterns: set[str] = set()
        self.ticks = self.heard_when_detached = 0
        self.subscribe(DriveCommand, self.on_command, topic="wheels")
        self.subscribe(
            EmergencyStop, self.on_state, MessageHandling.KEEP_ONLY_NEWEST, topic="emergency_stop_state"
        )
        self.subscribe_encoded("robbie_msgs/msg/*", lambda message: self.patterns.add(message.type_name))

    def on_command(self, command: DriveCommand) -> None:
        self.heard.append(command.header.stamp.sec)
        self.envelopes.append(self.envelope)
        if len(self.heard) == 1:
            with self.loan(Image, data=3) as image:
                assert self.publish(EmergencyStop(engaged=True, reason="a visitor"), topic="emergency_stop")
                image.data[:] = 7

    def on_state(self, state: EmergencyStop) -> None:
        if state.engaged and not self.heard_when_detached:
            self.heard_when_detached = len(self.heard)
            self.status = "stands still"
            wait_until(Visitor.is_detached)
            assert not self.publish(EmergencyStop(), topic="emergency_stop"), "it went nowhere"

    def tick(self) -> None:
        self.ticks += 1


@pytest.mark.slow
def test_module_run_as_a_tool_handles_publishes_ticks_and_reattaches(
    robot: Robot, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.write_profile(PROFILE)
    process = robot.start()
    robot.until(lambda modules: modules["base"]["status"] == "StandingBase is ready")
    run = robot.known_run()
    visitors: list[Visitor] = []
    purposes: list[str] = []

    def attach(run: KnownRun, purpose: str) -> Tool:
        purposes.append(purpose)
        if len(purposes) == 1:
            raise ControlRefused("as when the core has not given its last place back yet")
        return Tool(run, purpose)

    monkeypatch.setattr(tool, "Tool", attach)

    def is_done() -> bool:
        visitor = visitors[0]
        return visitor.heard_when_detached > 0 and len(visitor.heard) > visitor.heard_when_detached + 50

    Visitor.is_detached = staticmethod(lambda: TOOL not in robot.top())
    run_as_tool(run, Visitor, {}, "visitor", on_ready=visitors.append, is_stopped=is_done)
    (visitor,) = visitors
    assert len(purposes) > 1, "it was refused once, and asked again"
    assert "; attaching again" in caplog.text
    assert visitor.ticks > 0
    assert visitor.heard == sorted(set(visitor.heard))
    assert {envelope.sender for envelope in visitor.envelopes} == {"pulse"}
    assert "robbie_msgs/msg/EmergencyStop" in visitor.patterns
    assert robot.top()["base"]["status"] == "STOPPED: a visitor"
    robot.until(lambda modules: TOOL not in modules)
    ended = Ended.in_order(process, signal.SIGTERM)
    assert ended.modules["base"]["lost"] == ended.modules["pulse"]["refused"] == 0


class Lost:
    """An ended lease in an ended run."""

    outstanding = 0
    is_attached = False

    def __init__(self, *_arguments: object) -> None:
        self.is_closed = False
        self.outbox = self

    def take(self) -> None:
        raise Detached("it stood still")

    def show_status(self, _line: str) -> None:
        assert not self.is_closed, "its memory is not mapped any more"

    def counts(self) -> tuple[int, int]:
        assert not self.is_closed, "its memory is not mapped any more"
        return 0, 0

    def close(self) -> None:
        assert not self.is_closed, "it is closed"
        self.is_closed = True


def test_tool_ends_in_order_if_its_run_is_over_when_it_reattaches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = KnownRun("1f0c", tmp_path, is_live=False, record=None)
    monkeypatch.setattr(tool_bus, "Tool", Lost)
    bus = ToolBus(run, "visitor")
    with pytest.raises(RunEnded):
        bus.handle_next()
    bus.show_status("ends")
    assert not bus.publish(EmergencyStop(), "emergency_stop")
    bus.close()

    monkeypatch.setattr(message_stream, "Tool", Lost)
    monkeypatch.setattr(MessageStream, "_begin", lambda _stream: None)
    stream = MessageStream(run, [], "a tool")
    with pytest.raises(RunEnded):
        stream.receive()
    assert stream.missed == 0
    stream.close()


FORKING_TOOL = """
import os, time
from robbie_mp.attached.tool.tool import Tool
from robbie_mp.cli.runs import live_runs
[run] = [run for run in live_runs() if run.folder.is_relative_to(os.environ["XDG_RUNTIME_DIR"])]
tool = Tool(run, "a tool that forks")
fork = os.fork()
if fork:
    print(fork, flush=True)
time.sleep(1000)
"""


@pytest.mark.slow
def test_fork_of_a_tool_does_not_keep_its_place(robot: Robot) -> None:
    """The place is free when the connection is closed, and a fork has a copy of the tool's end."""
    robot.write_profile(PROFILE)
    process = robot.start()
    robot.until(lambda modules: modules["pulse"]["state"] == "RUNNING")
    with subprocess.Popen([sys.executable, "-c", FORKING_TOOL], stdout=subprocess.PIPE, text=True) as tool:
        assert tool.stdout is not None
        fork = int(tool.stdout.readline())
        assert robot.top()[TOOL]["pid"] == tool.pid
        tool.kill()
    try:
        wait_until(lambda: TOOL not in robot.top(), 10.0)
        assert is_running(fork)
    finally:
        os.kill(fork, signal.SIGKILL)
    process.send_signal(signal.SIGINT)
    assert Ended.wait_for(process).exit_code == 0
