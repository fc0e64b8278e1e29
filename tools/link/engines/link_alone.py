"""The transport of a link alone, without bus and modules: what is left are its protocol and Zenoh."""

import secrets
import threading
import time

from robbie_mp.connect.link.counts import LinkCounts
from robbie_mp.connect.link.header import ChannelId, ReceivedPacket
from robbie_mp.connect.link.node import LinkNode, NodeSettings, Offered
from robbie_mp.connect.link.receiving import Arrived, Fate
from robbie_mp.connect.link.sending import SendLimits
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.connect.link.wire import Endpoints, InboxLimits, Wire
from tools.link.engines.side import KEPT, OnMessage

PORT = 7447
TICK_S = 0.005
LIMITS = SendLimits(messages=1000, bytes=64 << 20, state_period_ns=10_000_000)
CHANNELS = {topic: ChannelId("link_msgs/msg/Probe", 1, topic) for topic in KEPT}


class LinkAlone:
    """An `Engine`. What of a command is too old, the receiver drops as for all engines."""

    def __init__(self, own: str, other: str, sends: list[str], on_message: OnMessage):
        self._on_message = on_message
        listens = "bulk" in sends
        name, session = "robot" if listens else "laptop", secrets.randbits(62) + 1
        address = [f"tcp/{own if listens else other}:{PORT}"]
        endpoints = Endpoints(
            listen=address if listens else (), connect=() if listens else address, datagrams=True
        )
        self._wake = threading.Event()
        self._wire = Wire(name, session, endpoints, InboxLimits(4096, 64 << 20), self._wake.set)
        settings = NodeSettings(LIMITS, max_bytes=1 << 26, latched_bytes=1 << 26)
        counts = LinkCounts(None, "link", session)
        self._node = LinkNode(name, session, counts, settings, self._wire, self._arrived)
        threading.Thread(target=self._run, daemon=True).start()

    def wait_for_room(self, topic: str) -> None:
        """Return at once: a link keeps the newest itself."""

    def send(self, topic: str, data: bytes) -> None:
        """Send a message."""
        now_ns = time.monotonic_ns()
        message = Offered(CHANNELS[topic], TrafficClass[topic.upper()], data, now_ns, is_latched=False)
        with self._wire.turns:
            self._node.offer(message, now_ns)

    def _arrived(self, message: Arrived) -> Fate:
        self._on_message(message.name.topic, message.data)
        return Fate.PUBLISHED

    def _run(self) -> None:
        """Do what the module of a link does with each tick."""
        self._wire.take_at_once(self._take_one)
        while True:
            self._wake.wait(TICK_S)
            self._wake.clear()
            with self._wire.turns:
                for robot in self._wire.seen():
                    self._node.meet(robot)
                for one in self._wire.received():
                    self._node.take(one)
                now_ns = time.monotonic_ns()
                self._wire.look_after(now_ns)
                self._node.tell_all(now_ns)
                self._node.look_after(now_ns)

    def _take_one(self, one: ReceivedPacket) -> None:
        if self._node.take_and_tell(one):
            self._wake.set()


ENGINE = LinkAlone
