"""The other robots of the team, as far as the link tells of them, and stops that they have not confirmed."""

from __future__ import annotations

import math
import time
from functools import partial
from typing import TYPE_CHECKING

from robbie_mp.bus.transport.endpoint import TooManyDeclarations
from robbie_mp.connect.link.header import ROBOT_NAME
from robbie_mp.messages import EmergencyStop, Header, LinkPeer, LinkState, OperatorRequest, RobotSummary, Time
from robbie_mp.station.fleet.topics import SUMMARY
from robbie_mp.station.stop.requests import REQUEST_TOPIC, STATE_TOPIC, StopRequests, state_text

if TYPE_CHECKING:
    from robbie_mp.module.clock import Clock
    from robbie_mp.station.module import Publish
    from robbie_mp.station.watch.latest import MessageSource

MAX_ROBOTS = 32
STALE_S = 2.0
"""A robot is shown as stale when its last message is older than this."""
LINK_STALE_S = 3.0
"""A link publishes its state once a second."""
STOPPED_BY = "all robots were stopped by hand on the page of {}"
HOLD_TOPIC = "operator_request"


class OtherRobot:
    """One other robot.

    Args:
        name: its name at the link.
        messages: source of what it tells.
        clock: tells the time.
        publish: sends to it.
        by: the name of this robot.
    """

    def __init__(self, name: str, messages: MessageSource, clock: Clock, publish: Publish, by: str):
        self.name = name
        self._messages, self._clock, self._publish, self._by = messages, clock, publish, by
        self.summary = messages.newest(RobotSummary, f"{name}/{SUMMARY}")
        self._stop = messages.newest(EmergencyStop, f"{name}/{STATE_TOPIC}")
        self.peer = LinkPeer(robot=name)
        # Ages are of this machine's clock: that of the station stands while a log beside it does.
        self._noted_s = -math.inf
        self._heard_s: float | None = None
        self._stop_heard_s: float | None = None
        self._waits_in_link = False
        self.summary.listen(self._hear)
        self._stop.listen(self._see)
        self.requests = StopRequests(self._send)

    def note(self, peer: LinkPeer) -> None:
        """Note what a link has just said of it."""
        self.peer, self._noted_s = peer, time.monotonic()
        if peer.is_up:
            self._waits_in_link = False

    @property
    def is_up(self) -> bool:
        """Whether a link hears it. A link that was started again may not know it any more."""
        return self.peer.is_up and time.monotonic() - self._noted_s < LINK_STALE_S

    def _age_s(self, heard_s: float | None) -> float | None:
        """Return the age of something that was heard, with the time that it was under way."""
        trip_s = self.peer.round_trip_s
        return None if heard_s is None else time.monotonic() - heard_s + (trip_s / 2 if trip_s > 0 else 0.0)

    @property
    def age_s(self) -> float | None:
        """Age of its last summary; None if there has been none."""
        return self._age_s(self._heard_s)

    @property
    def is_stale(self) -> bool:
        """Whether nobody knows how it is now."""
        age_s = self.age_s
        return age_s is None or age_s > STALE_S or not self.is_up

    @property
    def stop_state(self) -> str:
        """The state of its emergency stop, in words; NOT CONFIRMED while it has not confirmed a stop."""
        state = self._stop.message
        return state_text(
            self.requests.waits_s,
            None if state is None else state.engaged,
            self._age_s(self._stop_heard_s),
            "" if self.is_up else ": no link",
        )

    def hold(self) -> bool:
        """Order it to stand until it is told to go on. Any thread may call this."""
        return self._publish(OperatorRequest(wish=OperatorRequest.HOLD), topic=f"{self.name}/{HOLD_TOPIC}")

    def _send(self, engaged: bool) -> bool:
        """Send a stop to its base. Without a link, one waits in the link, which delivers it first."""
        if self._waits_in_link:
            return False
        message = EmergencyStop(
            header=Header(stamp=Time.from_nanoseconds(self._clock.now_ns())),
            engaged=engaged,
            reason=STOPPED_BY.format(self._by),
        )
        try:
            is_sent = self._publish(message, topic=f"{self.name}/{REQUEST_TOPIC}")
        except TooManyDeclarations:
            return False  # which must not keep the stop from other robots
        self._waits_in_link = is_sent and not self.is_up
        return is_sent

    def _hear(self, _summary: RobotSummary) -> None:
        self._heard_s = time.monotonic()

    def _see(self, state: EmergencyStop) -> None:
        self._stop_heard_s = time.monotonic()
        published_s = self._messages.envelope.published_ns / 1e9
        trip_s = self.peer.round_trip_s
        # It may have been under way since before the stop was sent.
        was_told_s = published_s - (trip_s if trip_s > 0 else 0.0)
        self.requests.see(engaged=state.engaged, published_s=was_told_s)


class OtherRobots:
    """All other robots that the link has met; none is ever forgotten.

    Args:
        messages: source of what they tell.
        clock: tells the time.
        publish: sends to them.
        own_name: the name of this robot.
    """

    def __init__(self, messages: MessageSource, clock: Clock, publish: Publish, own_name: str):
        self._make = partial(OtherRobot, messages=messages, clock=clock, publish=publish, by=own_name)
        self.all: dict[str, OtherRobot] = {}
        """By their names at the link. The dict is replaced and never changed, because pages read it."""
        self._left_out: frozenset[str] = frozenset()
        self._is_told = False
        self.own: RobotSummary | None = None
        """What this robot tells the others."""
        self.own_camera = ""
        """The camera whose pictures the others see; '' before the first picture."""
        messages.newest(LinkState).listen(self._note)

    @property
    def unknown(self) -> str:
        """Robots that nobody can stop from here, in words; '': there are none, as far as the link knows."""
        if not self._is_told:
            return "other robots"
        count = len(self._left_out)
        return f"{count} more than {len(self.all)} other robots" if count else ""

    def tick(self) -> None:
        """Repeat stops; called in the module's thread."""
        for robot in self.all.values():
            robot.requests.repeat()

    def _note(self, state: LinkState) -> None:
        """Notice new robots, and how each is heard."""
        for peer in state.peers:
            if peer.robot not in self.all and ROBOT_NAME.fullmatch(peer.robot):
                self._meet(peer.robot)
            if peer.robot in self.all:
                self.all[peer.robot].note(peer)
        self._is_told = True

    def _meet(self, name: str) -> None:
        try:
            if len(self.all) < MAX_ROBOTS:
                self.all = {**self.all, name: self._make(name)}
                return
        except TooManyDeclarations:
            pass
        self._left_out |= {name}
