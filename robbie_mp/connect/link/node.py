"""A link without its network and its bus: offers messages to other robots, takes theirs."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from robbie_mp.connect.link.counts import LinkCounts
from robbie_mp.connect.link.header import (
    ROBOT_NAME,
    Beat,
    ChannelId,
    DataHeader,
    Packet,
    ReceivedPacket,
    ReceiverReport,
    other_version,
    unpack,
)
from robbie_mp.connect.link.peer import Network, Peer
from robbie_mp.connect.link.receiving import Arrived, Fate
from robbie_mp.connect.link.sending import Item, SendLimits
from robbie_mp.connect.link.traffic import TrafficClass

MAX_PEERS = 128
"""Robots with which one link exchanges messages; it ignores further ones."""


class Offered(NamedTuple):
    """A message of this robot."""

    name: ChannelId
    traffic: TrafficClass
    data: bytes
    stamp_ns: int
    is_latched: bool = False
    type_hash: int = 0
    convert: Callable[[bytes], bytes] | None = None
    """Makes of `data` what is sent, only if its turn comes."""


@dataclass(frozen=True)
class NodeSettings:
    """The permissions of a link.

    Attributes:
        limits: how much may wait for each robot and class.
        max_bytes: size of the largest message.
        latched_bytes: newest messages of latched channels that are kept for robots to come.
        may_exchange: whether this link exchanges messages with a robot.
    """

    limits: SendLimits
    max_bytes: int
    latched_bytes: int
    may_exchange: Callable[[str], bool] = lambda _robot: True


class LinkNode:
    """The links with all other robots.

    Args:
        robot: the name of this robot.
        session: number of this process.
        counts: counts what is exchanged.
        settings: what it may do.
        network: sends packets.
        handle: publishes a message that has arrived, or refuses it.

    Attributes:
        malformed: packets that no link has packed, or that come from another robot than they say.
        strangers: packets of robots with which this link does not exchange messages.
    """

    def __init__(
        self,
        robot: str,
        session: int,
        counts: LinkCounts,
        settings: NodeSettings,
        network: Network,
        handle: Callable[[Arrived], Fate],
    ):
        self.robot = robot
        self.session = session
        self.counts = counts
        self.peers: dict[str, Peer] = {}
        self.malformed = 0
        self.strangers = 0
        self._settings = settings
        self._network = network
        self._handle = handle
        self._numbers: dict[tuple[ChannelId, TrafficClass], int] = {}
        self._latched: OrderedDict[ChannelId, Offered] = OrderedDict()

    def meet(self, robot: str) -> Peer | None:
        """Return another robot; None if this link does not exchange messages with it."""
        known = self.peers.get(robot)
        if known is not None:
            return known
        if robot == self.robot or not ROBOT_NAME.fullmatch(robot) or not self._settings.may_exchange(robot):
            return None
        if len(self.peers) >= MAX_PEERS:
            return None
        settings = self._settings
        peer = self.peers[robot] = Peer(
            self.robot,
            robot,
            self.session,
            self.counts,
            settings.limits,
            settings.max_bytes,
            self._network,
            self._handle,
        )
        return peer

    def offer(self, message: Offered, now_ns: int) -> None:
        """Send a message to every robot that has been met."""
        if message.is_latched:
            self._keep(message)
        for peer in self.peers.values():
            self._offer_to(peer, message, now_ns)
            peer.pump(now_ns)

    def offer_to(self, robot: str, message: Offered, now_ns: int) -> None:
        """Send a message to one robot that has been met."""
        self._offer_to(self.peers[robot], message, now_ns)
        self.peers[robot].pump(now_ns)

    def holds(self, robot: str, name: ChannelId, traffic: TrafficClass) -> bool:
        """Whether a message of a channel still waits to be sent to a robot."""
        number = self._numbers.get((name, traffic))
        return number is not None and self.peers[robot].streams[traffic].holds(number)

    def take_and_tell(self, received: ReceivedPacket) -> bool:
        """Take a packet, and tell its sender soon. Return whether something may be sent now because of it."""
        packet = self.take(received)
        if packet is None:
            return False
        peer = self.peers[packet.robot]
        if isinstance(packet, DataHeader):
            peer.tell_soon(packet.traffic, received.at_ns)
            return False
        return peer.has_more

    def take(self, received: ReceivedPacket) -> Packet | None:
        """Take a packet, whatever it holds, and return what it is. Call `tell_all` afterwards."""
        robot, header, payload, now_ns, is_datagram = received
        packet = unpack(header)
        if packet is None or packet.robot != robot:
            self.malformed += 1
            if robot in self.peers:
                self.peers[robot].other_version = other_version(header)
            return None
        peer = self.peers.get(robot) or self.meet(robot)
        if peer is None:
            self.strangers += 1
            return None
        if is_datagram:
            peer.took_datagram()
        if isinstance(packet, DataHeader):
            peer.take_data(packet, payload, now_ns)
        elif isinstance(packet, ReceiverReport):
            peer.take_report(packet, now_ns)
        elif isinstance(packet, Beat) and peer.take_beat(packet, now_ns):
            for message in self._latched.values():
                if not self.holds(peer.name, message.name, message.traffic):
                    self._offer_to(peer, message, now_ns)
        return packet

    def tell_all(self, now_ns: int) -> None:
        """Report what has just been taken, and send what may be sent now."""
        for peer in self.peers.values():
            peer.tell(now_ns)
            peer.pump(now_ns)

    def look_after(self, now_ns: int) -> None:
        """Do what is due; call this every few ms."""
        for peer in self.peers.values():
            peer.look_after(now_ns)

    def _offer_to(self, peer: Peer, message: Offered, now_ns: int) -> None:
        traffic = message.traffic
        number = self._numbers.setdefault((message.name, traffic), len(self._numbers))
        channel = peer.channel(number, message.name, traffic, message.type_hash)
        item = Item(channel, message.data, message.stamp_ns, message.is_latched, message.convert)
        peer.offer(traffic, item, now_ns)

    def _keep(self, message: Offered) -> None:
        """Keep the newest message of a latched channel; the oldest ones go if there is no room."""
        self._latched.pop(message.name, None)
        self._latched[message.name] = message
        size = sum(len(kept.data) for kept in self._latched.values())
        while size > self._settings.latched_bytes and self._latched:
            _, oldest = self._latched.popitem(last=False)
            size -= len(oldest.data)
