"""A module that joins a run from outside hears, speaks, ticks, and comes back when it was detached."""

import pytest

from robbie_mp.bus import Envelope
from robbie_mp.guest import run_guest
from robbie_mp.messages import DriveCommand, EmergencyStop
from robbie_mp.module import MessageHandling, Module
from tests.run.robot import Ended, Robot, wait_until

PROFILE = """
modules:
  base: {class: "zoo.modules:StandingBase"}
  pulse: {class: "zoo.modules:Pulse"}
tools: {count: 1}
"""
TOOL = "~tool1"


class Visitor(Module):
    """Stops the base as soon as it hears the pulse, and stands still once."""

    period_s = 0.01
    is_detached = None

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
            assert self.publish(EmergencyStop(engaged=True, reason="a visitor"), topic="emergency_stop")

    def on_state(self, state: EmergencyStop) -> None:
        if state.engaged and not self.heard_when_detached:
            self.heard_when_detached = len(self.heard)
            self.status = "stands still"
            wait_until(self.is_detached)
            assert not self.publish(EmergencyStop(), topic="emergency_stop"), "it went nowhere"

    def tick(self) -> None:
        self.ticks += 1


def test_guest_hears_speaks_ticks_and_attaches_again_when_it_was_detached(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    robot.write_profile(PROFILE)
    process = robot.start()
    robot.until(lambda modules: modules["base"]["status"] == "StandingBase is ready")
    run = robot.known_run()
    visitors: list[Visitor] = []

    def is_done() -> bool:
        visitor = visitors[0]
        return visitor.heard_when_detached > 0 and len(visitor.heard) > visitor.heard_when_detached + 50

    Visitor.is_detached = staticmethod(lambda: TOOL not in robot.top())
    run_guest(run, Visitor, {}, "visitor", on_ready=visitors.append, is_stopped=is_done)
    (visitor,) = visitors
    assert "; attaches again" in caplog.text
    assert visitor.ticks > 0
    assert visitor.heard == sorted(set(visitor.heard))
    assert {envelope.sender for envelope in visitor.envelopes} == {"pulse"}
    assert "robbie_msgs/msg/EmergencyStop" in visitor.patterns
    assert robot.top()["base"]["status"] == "STOPPED: a visitor"
    robot.until(lambda modules: TOOL not in modules)
    process.terminate()
    ended = Ended.wait_for(process)
    assert ended.exit_code == 0
    assert ended.modules["base"]["lost"] == ended.modules["pulse"]["refused"] == 0
