"""Links of robots without robots: `python -m tools.link.scale.robots PLAN`, PLAN as JSON.

Each has a session of Zenoh and everything that a link has below its module. They send each other states.
The process prints what it has measured as JSON.
"""

import json
import secrets
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase

from robbie_mp.connect.link.books import Books
from robbie_mp.connect.link.header import ChannelId
from robbie_mp.connect.link.node import LinkNode, NodeSettings, Offered
from robbie_mp.connect.link.receiving import Arrived, Fate
from robbie_mp.connect.link.sending import Limits
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.connect.link.wire import Endpoints, InboxLimits, Received, Wire
from robbie_mp.messages import Odometry

TICK_S = 0.01
"""As that of the module."""
STATE = ChannelId(Odometry.type_name, Odometry.version, "odom")
STATE_BYTES = 700
"""About the size of an odometry with its covariances."""
LIMITS = NodeSettings(Limits(1000, 1 << 24, 0), max_bytes=1 << 20, latched_bytes=1 << 20)


@dataclass(frozen=True)
class Plan:
    """What the robots of one process do. Times by the monotonic clock of this machine.

    Attributes:
        address: of the router.
        robots: their names.
        others: with whom they exchange messages, as a pattern.
        partners: how many these are.
        state_hz: states that each sends in a second.
        begin_s: beginning of the measurement.
        end_s: its end.
    """

    address: str
    robots: Sequence[str]
    others: str
    partners: int
    state_hz: float
    begin_s: float
    end_s: float


@dataclass
class Result:
    """What the robots of one process have measured.

    Attributes:
        up: partners that were heard at the end, of all robots together.
        sent: states that were to arrive.
        latencies_ms: of those that have arrived.
        packets: packets that have arrived.
        cpu_s: processor time of this process.
    """

    up: int = 0
    sent: int = 0
    latencies_ms: list[float] | None = None
    packets: int = 0
    cpu_s: float = 0.0


class Robot:
    """The link of one robot.

    Args:
        name: its name.
        plan: what it does.
        result: what it has measured.
    """

    def __init__(self, name: str, plan: Plan, result: Result):
        self._plan, self._result = plan, result
        self._due_s = time.monotonic() + secrets.randbelow(1000) / 1000 / plan.state_hz
        session = secrets.randbits(63) | 1
        endpoints = Endpoints("client", connect=[plan.address])
        self._wire = Wire(name, session, endpoints, InboxLimits(4096, 1 << 24), lambda: None)
        settings = NodeSettings(
            LIMITS.limits,
            LIMITS.max_bytes,
            LIMITS.latched_bytes,
            lambda other: fnmatchcase(other, plan.others),
        )
        books = Books(None, name, session)
        self.node = LinkNode(name, session, books, settings, self._wire, self._on_arrived)
        self._wire.take_at_once(self._take)

    def tick(self) -> None:
        """Do what the module does with each tick, and send a state if one is due."""
        with self._wire.turns:
            for other in self._wire.seen():
                self.node.meet(other)
            for one in self._wire.received():
                self._take(one)
            now_s = time.monotonic()
            self.node.look_after(round(now_s * 1e9))
            self.node.tell_all(round(now_s * 1e9))
            if now_s >= self._due_s:
                self._due_s = max(now_s, self._due_s + 1 / self._plan.state_hz)
                self._send(now_s)

    def _send(self, now_s: float) -> None:
        now_ns = round(now_s * 1e9)
        if self._plan.begin_s <= now_s < self._plan.end_s:
            self._result.sent += self._plan.partners
        self.node.offer(Offered(STATE, TrafficClass.STATE, bytes(STATE_BYTES), now_ns), now_ns)

    def _take(self, one: Received) -> None:
        if self._plan.begin_s <= one.at_ns * 1e-9 < self._plan.end_s:
            self._result.packets += 1
        self.node.take_and_tell(one.robot, one.header, one.payload, one.at_ns, is_datagram=one.is_datagram)

    def _on_arrived(self, message: Arrived) -> Fate:
        if self._plan.begin_s <= message.stamp_ns * 1e-9 < self._plan.end_s:
            assert self._result.latencies_ms is not None
            self._result.latencies_ms.append((time.monotonic_ns() - message.stamp_ns) * 1e-6)
        return Fate.PUBLISHED

    @property
    def up(self) -> int:
        """How many others are heard."""
        now_ns = time.monotonic_ns()
        return sum(peer.is_up(now_ns) for peer in self.node.peers.values())

    def close(self) -> None:
        """End the session."""
        self._wire.take_at_once(None)
        self._wire.close()


def main(plan: Plan) -> Result:
    """Run the robots until the measurement is over, and a little longer for what is under way."""
    result = Result(latencies_ms=[])
    robots = [Robot(name, plan, result) for name in plan.robots]
    used_s = 0.0
    while (now_s := time.monotonic()) < plan.end_s + 0.5:
        if now_s < plan.begin_s:
            used_s = time.process_time()
        elif now_s < plan.end_s:
            result.cpu_s = time.process_time() - used_s
        for robot in robots:
            robot.tick()
        time.sleep(max(0.0, now_s + TICK_S - time.monotonic()))
    result.up = sum(robot.up for robot in robots)
    for robot in robots:
        robot.close()
    return result


if __name__ == "__main__":
    print(json.dumps(asdict(main(Plan(**json.loads(sys.argv[1]))))))
