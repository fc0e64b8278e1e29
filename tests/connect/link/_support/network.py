"""Links without processes: a network with delay, loss and limited bandwidth, in its own time."""

import heapq
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from robbie_mp.connect.link.counts import ExchangeCounts, LinkCounts
from robbie_mp.connect.link.header import Beat, ChannelId, DataHeader, ReceivedPacket, ReceiverReport, pack
from robbie_mp.connect.link.node import LinkNode, NodeSettings, Offered
from robbie_mp.connect.link.receiving import Arrived, Fate
from robbie_mp.connect.link.sending import SendLimits
from robbie_mp.connect.link.traffic import TrafficClass

MS = 1_000_000
TICK_NS = 5 * MS
LIMITS = SendLimits(messages=10_000, bytes=1 << 26, state_period_ns=0)


@dataclass
class Conditions:
    """What the network does to packets; each direction has the bandwidth for itself."""

    delay_ns: int = MS
    jitter_ns: int = 0
    loss: float = 0.0
    bytes_per_s: float = 1e8
    is_cut: bool = False
    queue_bytes: int = 1 << 20
    """Packets that find more in front of them are lost."""
    joins_datagrams: bool = False
    """Datagrams that a robot sends at the same time arrive together, or not at all."""


class Network:
    """Carries packets between robots. Times in ns."""

    def __init__(self, seed: int, conditions: Conditions | None = None):
        self.random = random.Random(seed)
        self.conditions = conditions or Conditions()
        self.now_ns = 1000 * MS
        self.robots: dict[str, Robot] = {}
        self.carried: list[tuple[int, str, DataHeader | ReceiverReport | Beat, int]] = []
        """Time of arrival, receiver, header and size of every packet that has arrived."""
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._numbers = count()
        self._free_ns: dict[tuple[str, str], int] = {}
        self._last_ns: dict[tuple[str, str], int] = {}
        self._fates: dict[tuple[str, str], tuple[int, bool]] = {}
        """When the last datagram was sent, and whether it was lost."""

    def at(self, at_ns: int, action: Callable[[], None]) -> None:
        """Do something at a time."""
        heapq.heappush(self._events, (at_ns, next(self._numbers), action))

    def run(self, seconds: float) -> None:
        """Let time pass."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while self._events and self._events[0][0] <= end_ns:
            self.now_ns, _, action = heapq.heappop(self._events)
            action()
        self.now_ns = end_ns

    def carry(
        self,
        sender: str,
        receiver: str,
        packet: DataHeader | ReceiverReport | Beat,
        payload: bytes,
        is_datagram: bool = False,
    ) -> None:
        """Carry a packet, in order, or lose it."""
        conditions, way = self.conditions, (sender, receiver)
        header = pack(packet)
        size = len(header) + len(payload) + 60
        free_ns = max(self._free_ns.get(way, 0), self.now_ns)
        waits = (free_ns - self.now_ns) / 1e9 * conditions.bytes_per_s
        is_lost, joins = self.random.random() < conditions.loss, conditions.joins_datagrams and is_datagram
        if joins and self._fates.get(way, (0, False))[0] == self.now_ns:
            is_lost = self._fates[way][1]
        if joins:
            self._fates[way] = (self.now_ns, is_lost)
        if conditions.is_cut or is_lost or waits > conditions.queue_bytes:
            return
        sent_ns = free_ns + round(size / conditions.bytes_per_s * 1e9)
        self._free_ns[way] = sent_ns
        jitter = conditions.jitter_ns
        arrives_ns = sent_ns + conditions.delay_ns + self.random.randint(-jitter, jitter)
        arrives_ns = self._last_ns[way] = max(arrives_ns, self._last_ns.get(way, 0))

        def arrive() -> None:
            if receiver in self.robots and not self.conditions.is_cut:
                self.carried.append((self.now_ns, receiver, packet, size))
                self.robots[receiver].take(sender, header, payload, is_datagram=is_datagram)

        self.at(arrives_ns, arrive)


@dataclass
class Robot:
    """A robot with a link that can be killed; `journal` is what its modules have received."""

    network: Network
    name: str
    folder: Path | None = None
    limits: SendLimits = LIMITS
    journal: list[tuple[int, Arrived]] = field(default_factory=list)
    """Time, and what was published."""
    fate: Callable[[Arrived], Fate] = lambda _message: Fate.PUBLISHED
    others: list[str] = field(default_factory=list)
    sessions: int = 0
    latched: dict[ChannelId, Offered] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.network.robots[self.name] = self
        self.node: LinkNode | None = None
        self.start()
        self._tick()

    @property
    def joins_datagrams(self) -> bool:
        """As the network does."""
        return self.network.conditions.joins_datagrams

    def start(self) -> None:
        """Start a process of the link."""
        self.sessions += 1
        session = self.network.random.getrandbits(63)
        self.counts = LinkCounts(self.folder, "link", session)
        settings = NodeSettings(self.limits, max_bytes=1 << 26, latched_bytes=1 << 24)
        self.node = LinkNode(self.name, session, self.counts, settings, self, self._handle)
        for other in self.others:
            self.node.meet(other)
        for message in self.latched.values():  # as the core gives them to a module that starts
            self.node.offer(message, self.network.now_ns)

    def kill(self) -> None:
        """Kill the link's process."""
        self.node = None
        self.counts.close()

    def __enter__(self) -> "Robot":
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def forget(self) -> None:
        """Lose the shared memory, as when the whole robot is killed."""
        assert self.folder is not None
        for file in self.folder.iterdir():
            file.unlink()

    def offer(self, name: ChannelId, traffic: TrafficClass, data: bytes, *, is_latched: bool = False) -> None:
        """Publish a message on this robot's bus."""
        message = Offered(name, traffic, data, self.network.now_ns, is_latched)
        if is_latched:
            self.latched[name] = message
        if self.node is not None:
            self.node.offer(message, self.network.now_ns)

    def send(
        self,
        robot: str,
        packet: DataHeader | ReceiverReport | Beat,
        payload: memoryview | bytes,
        *,
        as_datagram: bool = False,
        at_once: bool = False,
    ) -> None:
        """Send a packet of the link."""
        self.network.carry(self.name, robot, packet, bytes(payload), as_datagram)

    def take(self, sender: str, header: bytes, payload: bytes, *, is_datagram: bool = False) -> None:
        """Take a packet from the network."""
        if self.node is not None:
            now_ns = self.network.now_ns
            if self.node.take_and_tell(ReceivedPacket(sender, header, payload, now_ns, is_datagram)):
                self.node.tell_all(now_ns)

    def received(self, name: ChannelId) -> list[bytes]:
        """What its modules have received on a channel, in order."""
        return [message.data for _, message in self.journal if message.name == name]

    def account(self, name: ChannelId, *, is_sent: bool = True) -> ExchangeCounts:
        """The counts of a channel with the other robot."""
        (found,) = (one for one in self.counts.channels() if one.channel == name and one.is_sent == is_sent)
        return found

    def _handle(self, message: Arrived) -> Fate:
        fate = self.fate(message)
        if fate is Fate.PUBLISHED:
            self.journal.append((self.network.now_ns, message))
        return fate

    def _tick(self) -> None:
        if self.node is not None:
            self.node.tell_all(self.network.now_ns)
            self.node.look_after(self.network.now_ns)
        self.network.at(self.network.now_ns + TICK_NS, self._tick)


def two_robots(
    seed: int, conditions: Conditions | None = None, folder: Path | None = None, limits: SendLimits = LIMITS
) -> tuple[Network, Robot, Robot]:
    """Two robots that have found each other."""
    network = Network(seed, conditions)
    folders = []
    for name in ("red", "blue"):
        if folder is not None:
            (folder / name).mkdir()
        folders.append(None if folder is None else folder / name)
    red = Robot(network, "red", folders[0], limits, others=["blue"])
    blue = Robot(network, "blue", folders[1], limits, others=["red"])
    network.run(0.5)
    return network, red, blue
