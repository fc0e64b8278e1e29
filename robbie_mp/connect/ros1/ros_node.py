"""The ROS 1 node: a process of its own, run by the Python that has rospy.

It imports nothing of Robbie-MP. It passes bytes on and decodes no message. The bridge starts it, and speaks
to it in frames over a pair of sockets: its end of them is its first argument, and the bridge's pid the
second. It ends with the bridge.

rospy never registers a node again when the ROS master has been restarted. So this node looks twice a second
whether the master knows it, and otherwise registers all its topics once more, with the public calls of the
master's and of the node's own XML-RPC server. Connections to other nodes stay as they are.

Many messages that move the robot have no stamp, and TCP tells nobody how long they were under way. So this
node asks their publishers again and again how many messages they have sent; see `_Origin`.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import json
import os
import signal
import socket
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from http.client import HTTPException
from importlib import import_module
from typing import Any, NamedTuple
from xmlrpc import client

FRAME = struct.Struct("<IBHQ")
"""Size of the payload, kind, channel, and when it was sent: the machine's monotonic clock, in nanoseconds."""
MAX_PAYLOAD = 256 << 20

PUBLISH = 1  # to the node: publish on a topic; JSON
SUBSCRIBE = 2  # to the node: subscribe to a topic; JSON
PARAMETER = 3  # to the node: set a parameter; JSON
MESSAGE = 4  # both ways: a message of a channel, as ROS 1 serialises it
READY = 5  # from the node: the master knows it
STATE = 6  # from the node: JSON; also a sign of life
ANNOUNCE = 7  # from the node: the type of the messages that follow under a new number; JSON

ANY = "*"
"""Type and MD5 sum of a subscriber that takes messages of any type."""
FIRST_ANNOUNCED = 1 << 15
"""The first number that the node gives to the messages of a type."""
MAX_ANNOUNCED = 64
"""Most types that the node announces. Later ones come under the number of their topic."""
MAX_DEFINITION = 256 << 10
"""Characters of the longest definition that is announced whole."""

NO_ROSPY = 4
"""Exit code: this Python has no rospy."""
NAME_TAKEN = 3
"""Exit code: another node has taken the name."""

LOOK_S = 0.25
MASTER_LOOK_S = 0.5
MASTER_TIMEOUT_S = 2.0
BUFFER_BYTES = 16 << 20
NO_MASTER = (ValueError, TypeError, IndexError, SyntaxError, HTTPException)
"""The errors of calls to a server that is no ROS master."""
ASK_S, ASK_IDLE_S = 0.05, 0.25
"""Time between two questions to a publisher that sends messages, and to one that does not."""
BUSY_S = 2.0
"""A publisher counts as sending for this time after a message."""
ASKERS = 4
"""Questions that are under way at a time, so that a slow network does not make them rarer."""
MISSED_S, NEAR_S = 1.0, 0.1
"""Messages that are missing for this time, over a connection that is faster than the second, never come."""
MAX_ANSWERS = 256
MAX_MET = 1000
KEPT_S = 2.0
"""Latched messages that come this soon after the node has subscribed may be from before."""
MAX_WAITING = 1000
MAX_WAITING_BYTES = 64 << 20


class NodeFrame(NamedTuple):
    """The messages between the bridge and the node.

    Attributes:
        kind: what it is.
        channel: the number of its topic or type.
        sent_ns: when it was sent. Of a message that may move the robot: the time after which its publisher
            has sent it; 0 if that is not known.
        payload: the message.
    """

    kind: int
    channel: int
    sent_ns: int
    payload: bytes


def pack(kind: int, channel: int, payload: bytes, sent_ns: int | None = None) -> bytes:
    """Return a frame as bytes; it is sent now unless another time is given."""
    sent_ns = time.monotonic_ns() if sent_ns is None else sent_ns
    return FRAME.pack(len(payload), kind, channel, sent_ns) + payload


def frames(link: socket.socket) -> Iterator[NodeFrame]:
    """Yield the frames that arrive, until the other side goes."""
    with link.makefile("rb", buffering=1 << 16) as stream:
        while True:
            try:
                head = stream.read(FRAME.size)
                if len(head) < FRAME.size:
                    return
                size, kind, channel, sent_ns = FRAME.unpack(head)
                if size > MAX_PAYLOAD:
                    return
                payload = stream.read(size)
            except (OSError, ValueError):
                return
            if len(payload) < size:
                return
            yield NodeFrame(kind, channel, sent_ns, payload)


class _Outbox:
    """Frames on their way to the bridge; a bridge that stands still costs the oldest messages."""

    def __init__(self, link: socket.socket):
        self._link = link
        self._condition = threading.Condition()
        self._announcements: deque[bytes] = deque()
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._bytes = 0
        self.dropped = 0

    def announce(self, channel: int, payload: bytes) -> None:
        """Append a frame that must not be lost; it overtakes messages."""
        with self._condition:
            self._announcements.append(pack(ANNOUNCE, channel, payload))
            self._condition.notify()

    def push(self, kind: int, channel: int, payload: bytes, sent_ns: int | None = None) -> None:
        """Append a frame, as `pack` makes it."""
        frame = pack(kind, channel, payload, sent_ns)
        with self._condition:
            while self._waiting and (
                len(self._waiting) >= MAX_WAITING or self._bytes + len(frame) > MAX_WAITING_BYTES
            ):
                old_kind, old = self._waiting.popleft()
                self._bytes -= len(old)
                self.dropped += old_kind == MESSAGE
            self._waiting.append((kind, frame))
            self._bytes += len(frame)
            self._condition.notify()

    def run(self) -> None:
        while True:
            with self._condition:
                while not (self._waiting or self._announcements):
                    self._condition.wait()
                if self._announcements:
                    frame = self._announcements.popleft()
                else:
                    _, frame = self._waiting.popleft()
                    self._bytes -= len(frame)
            try:
                self._link.sendall(frame)
            except OSError:
                os._exit(0)


class _Origin:
    """A connection to a publisher, and how old what comes from it can be.

    The publisher's node says how many messages it has sent on the connection (`getBusStats` of its XML-RPC
    server). It has sent all later messages after that question, whatever any clock says, and however long
    they wait in a buffer or in a network.

    Args:
        transport: rospy's end of the connection.
        topic: the topic.
        name: this node's name.
        began_ns: before this time there was no connection; 0 if its first message may be older than it.
        on_lost: called when messages were lost on the way, so that counting is no use any more.
    """

    def __init__(self, transport: Any, topic: str, name: str, began_ns: int, on_lost: Callable[[], object]):
        self.header = transport.header
        self._transport, self._topic, self._name, self._on_lost = transport, topic, name, on_lost
        self._is_near = _is_near(transport.socket)
        self._lock, self._turn, self._sends = threading.Lock(), threading.Lock(), threading.Event()
        self._received = 0
        self._received_s = self._complete_s = time.monotonic()
        self._asked_ns: dict[int, int] = {}
        """When a question was asked whose answer was this number of messages."""
        self._after_ns = began_ns
        self._is_silent = False
        for _ in range(ASKERS):
            threading.Thread(target=self._ask, daemon=True).start()

    @property
    def is_open(self) -> bool:
        """Whether messages may still come."""
        return not self._transport.done and self._transport.header is self.header

    def take(self) -> int:
        """Count a message, and return the time after which it was sent; 0 if that is not known."""
        with self._lock:
            self._received += 1
            self._received_s = time.monotonic()
            told = [self._asked_ns.pop(sent) for sent in list(self._asked_ns) if sent < self._received]
            self._after_ns = max(self._after_ns, *told, 0)
        self._sends.set()
        # Some nodes do not count. From this machine, messages come at once.
        return time.monotonic_ns() if self._is_silent and self._is_near else self._after_ns

    def _ask(self) -> None:
        node, number = _proxy(self._transport.endpoint_id), None
        while self.is_open:
            with self._turn:
                self._pause()
            try:
                number = self._number(node) if number is None else number
                asked_ns = time.monotonic_ns()
                self._learn(self._count(node, number), asked_ns)
                self._is_silent = False
            except (OSError, client.Error, *NO_MASTER):
                self._is_silent, number = True, None

    def _pause(self) -> None:
        time.sleep(ASK_S)
        if time.monotonic() - self._received_s > BUSY_S:
            self._sends.clear()
        self._sends.wait(ASK_IDLE_S - ASK_S)

    def _number(self, node: Any) -> Any:
        """Return the publisher's number of the connection: the newest one to this node."""
        ours = [self._name, "o", "TCPROS", self._topic]
        return [one[0] for one in node.getBusInfo(self._name)[2] if one[1:5] == ours][-1]

    def _count(self, node: Any, number: Any) -> int:
        """Return how many messages the publisher has sent."""
        answer = node.getBusStats(self._name)
        topics = answer[0] if isinstance(answer[0], list) else answer[2][0]  # roscpp leaves the code out
        counts = [one for topic in topics if topic[0] == self._topic for one in topic[-1]]
        *_, sent, _is_connected = next(one for one in counts if one[0] == number)
        return int(sent)

    def _learn(self, sent: int, asked_ns: int) -> None:
        now_s = time.monotonic()
        with self._lock:
            if sent <= self._received or now_s - asked_ns / 1e9 > NEAR_S:
                self._complete_s = now_s
            if len(self._asked_ns) >= MAX_ANSWERS:
                del self._asked_ns[min(self._asked_ns)]
            self._asked_ns[sent] = max(self._asked_ns.get(sent, 0), asked_ns)
        if now_s - self._complete_s > MISSED_S and self.is_open:
            self._transport.close()
            self._on_lost()


def _is_near(link: socket.socket | None) -> bool:
    """Whether both ends of a connection are on this machine."""
    try:
        return link is not None and bool(link.getpeername()[0] == link.getsockname()[0])
    except OSError:  # it has ended
        return False


class _Node:
    """The node in ROS.

    Args:
        rospy: the module of that name.
        link: this side's socket.
        outbox: frames to the bridge.
    """

    def __init__(self, rospy: Any, link: socket.socket, outbox: _Outbox):
        self._rospy = rospy
        self._link = link
        self._outbox = outbox
        self._name = rospy.get_name()
        self._uri = rospy.get_node_uri()
        self._master = _proxy(os.environ["ROS_MASTER_URI"])
        self._own = _proxy(self._uri)
        self._registered_at = 0
        self._publishers: dict[int, Any] = {}
        self._subscribers: dict[int, Any] = {}
        self._parameters: dict[str, Any] = {}
        self._are_parameters_due = False
        self._failed = 0
        self._numbers: dict[tuple[int, str, str, str], int] = {}
        self._numbers_lock = threading.Lock()
        self._looked_ns: dict[int, int] = {}
        """When the publishers of a channel whose messages may move the robot were looked at last."""
        self._began_ns: dict[int, dict[Any, int]] = {}
        """By channel and connection: a time before it began."""
        self._met: deque[tuple[int, str]] = deque(maxlen=MAX_MET)
        """Channels and publishers that were connected."""
        self._origins: list[_Origin] = []
        self._origins_lock = threading.Lock()

    # -- from the bridge to ROS

    def read(self) -> None:
        """Do what the bridge says, until it goes."""
        for frame in frames(self._link):
            if frame.kind == MESSAGE:
                self._publish(frame)
            elif frame.kind == PUBLISH:
                self._open_publisher(frame.channel, json.loads(frame.payload))
            elif frame.kind == SUBSCRIBE:
                self._open_subscriber(frame.channel, json.loads(frame.payload))
            elif frame.kind == PARAMETER:
                self._parameters.update(json.loads(frame.payload))
                self._are_parameters_due = True

    def _publish(self, frame: NodeFrame) -> None:
        publisher = self._publishers[frame.channel]
        message = publisher.data_class()
        message._buff = frame.payload
        try:
            publisher.publish(message)
        except Exception:  # whatever a subscriber's connection has run into
            self._failed += 1

    def _open_publisher(self, channel: int, wish: dict[str, Any]) -> None:
        self._publishers[channel] = self._rospy.Publisher(
            wish["topic"], self._raw_type(wish), latch=wish["latched"], queue_size=wish["depth"]
        )

    def _open_subscriber(self, channel: int, wish: dict[str, Any]) -> None:
        opened_s = time.monotonic()
        moves = not wish["latched"]
        if moves:
            self._looked_ns[channel] = time.monotonic_ns()

        def is_old(header: dict[str, str]) -> bool:
            """Whether it may be an order from before that its publisher has kept."""
            return moves and header.get("latching") == "1" and time.monotonic() - opened_s < KEPT_S

        def take(message: Any) -> None:
            header = message._connection_header
            if header.get("callerid") == self._name:
                return
            sent_ns = self._sent_after_ns(channel, header) if moves else None
            if is_old(header):
                self._outbox.dropped += 1
                return
            number = self._number(channel, header) if wish["type"] == ANY else channel
            self._outbox.push(MESSAGE, number, message._buff, sent_ns)

        # What may move the robot has to be counted, and must not wait for more to send with it.
        options = {"tcp_nodelay": True} if moves else {"queue_size": wish["depth"]}
        self._subscribers[channel] = self._rospy.Subscriber(
            wish["topic"], self._raw_type(wish), take, buff_size=BUFFER_BYTES, **options
        )

    def _sent_after_ns(self, channel: int, header: dict[str, str]) -> int:
        """Return the time after which a message of a connection was sent; 0 if that is not known."""
        self._meet_publishers(channel)
        return next((one.take() for one in list(self._origins) if one.header is header), 0)

    def _meet_publishers(self, channel: int) -> None:
        """Begin to ask the publishers of new connections."""
        subscriber = self._subscribers.get(channel)
        if subscriber is None:  # rospy is still opening it
            return
        with self._origins_lock:  # each connection has a thread
            now_ns, looked_ns = time.monotonic_ns(), self._looked_ns[channel]
            connections, before = list(subscriber.impl.connections), self._began_ns.get(channel, {})
            self._began_ns[channel] = {one: before.get(one, looked_ns) for one in connections}
            self._looked_ns[channel] = now_ns
            self._origins = [one for one in self._origins if one.is_open]
            known = [id(one.header) for one in self._origins]
            for transport in connections:
                header = transport.header or {"callerid": self._name}
                if header.get("callerid") != self._name and id(header) not in known:
                    self._meet(channel, transport, subscriber.resolved_name)

    def _meet(self, channel: int, transport: Any, topic: str) -> None:
        met = (channel, transport.endpoint_id)
        keeps = transport.header.get("latching") == "1" and met in self._met  # it gives an old order again
        began_ns = 0 if keeps else self._began_ns[channel][transport]
        self._met.append(met)
        self._origins.append(_Origin(transport, topic, self._name, began_ns, self._register_again))

    def _register_again(self) -> None:
        """Have `_look` register everything, and connect to publishers that are not connected."""
        self._registered_at = 0

    def _number(self, channel: int, header: dict[str, str]) -> int:
        """Return the number for messages of a connection, which says what type they have."""
        definition = header.get("message_definition", "")
        key = (channel, header.get("type", ""), header.get("md5sum", ""), definition)
        with self._numbers_lock:  # each connection has a thread
            number = self._numbers.get(key)
            if number is None:
                if len(self._numbers) >= MAX_ANNOUNCED:
                    return channel
                number = self._numbers[key] = FIRST_ANNOUNCED + len(self._numbers)
                about = {
                    "channel": channel,
                    "type_name": key[1][:MAX_DEFINITION],
                    "md5": key[2][:MAX_DEFINITION],
                    "definition": definition[: MAX_DEFINITION + 1],
                }
                self._outbox.announce(number, json.dumps(about).encode())
            return number

    def _raw_type(self, wish: dict[str, Any]) -> Any:
        """Return a message class for rospy whose messages are bytes."""
        members = {
            "_md5sum": wish["md5"],
            "_type": wish["type"],
            "_full_text": wish["definition"],
            "_has_header": False,
        }
        return type("Raw", (self._rospy.AnyMsg,), members)

    # -- the master, and from ROS to the bridge

    def watch(self) -> None:
        """Look after the registrations, and say how things are, as long as ROS lets this node live."""
        is_there, looked_at = True, -MASTER_LOOK_S
        while not self._rospy.is_shutdown():
            if time.monotonic() - looked_at >= MASTER_LOOK_S:
                looked_at = time.monotonic()
                try:
                    self._look()
                    is_there = True
                except (OSError, client.Error, *NO_MASTER):
                    is_there = False
            self._say(is_there)
            for channel in list(self._looked_ns):
                self._meet_publishers(channel)
            time.sleep(LOOK_S)
        os._exit(NAME_TAKEN)

    def _say(self, is_there: bool) -> None:
        publishers = list(self._publishers.items())
        state = {
            "master": is_there,
            "listeners": {str(channel): one.get_num_connections() for channel, one in publishers},
            "dropped": self._outbox.dropped,
            "failed": self._failed,
        }
        self._outbox.push(STATE, 0, json.dumps(state).encode())

    def _look(self) -> None:
        """Register everything if the master is another one, or does not know this node."""
        master = self._master.getPid(self._name)[2]
        code, _, uri = self._master.lookupNode(self._name, self._name)
        if master != self._registered_at or (code, uri) != (1, self._uri):
            for one in list(self._publishers.values()):
                self._master.registerPublisher(self._name, one.resolved_name, one.type, self._uri)
            for one in list(self._subscribers.values()):
                self._register_subscriber(one)
            self._are_parameters_due = True
            self._registered_at = master
        if self._are_parameters_due:
            self._are_parameters_due = False
            for name, value in list(self._parameters.items()):
                self._master.setParam(self._name, name, value)

    def _register_subscriber(self, one: Any) -> None:
        code, _, uris = self._master.registerSubscriber(self._name, one.resolved_name, one.type, self._uri)
        if code == 1 and uris:
            self._own.publisherUpdate("/master", one.resolved_name, uris)


class _ImpatientTransport(client.Transport):
    """Does not wait long for an answer."""

    def make_connection(self, host: Any) -> Any:
        connection = super().make_connection(host)
        connection.timeout = MASTER_TIMEOUT_S
        return connection


def _proxy(uri: str) -> Any:
    """Return what calls an XML-RPC server."""
    return client.ServerProxy(uri, transport=_ImpatientTransport())


def _await_master(name: str, outbox: _Outbox) -> None:
    master = _proxy(os.environ["ROS_MASTER_URI"])
    while True:
        try:
            master.getPid(name)
        except (OSError, client.Error, *NO_MASTER):
            outbox.push(STATE, 0, json.dumps({"master": False}).encode())
            time.sleep(MASTER_LOOK_S)
        else:
            return


def _die_with(bridge: int) -> None:
    """Have the kernel kill this process when the bridge ends."""
    set_parent_death_signal = 1
    ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)
    if os.getppid() != bridge:
        os._exit(0)


def main(descriptor: int, bridge: int, name: str) -> None:
    """Be the node.

    Args:
        descriptor: this side's socket.
        bridge: pid of the bridge.
        name: the node's name in ROS.
    """
    _die_with(bridge)
    link = socket.socket(fileno=descriptor)
    outbox = _Outbox(link)
    threading.Thread(target=outbox.run, daemon=True).start()
    _await_master(f"/{name}", outbox)
    try:
        rospy = import_module("rospy")
    except ImportError:
        os._exit(NO_ROSPY)
    with contextlib.redirect_stderr(io.StringIO()):  # it says that its own log is disabled, as it should be
        rospy.init_node(name, argv=[], disable_rosout=True, disable_rostime=True, disable_signals=True)
    node = _Node(rospy, link, outbox)
    outbox.push(READY, 0, b"")
    threading.Thread(target=node.watch, daemon=True).start()
    node.read()
    os._exit(0)  # at once: rospy's own way asks the master, which may be gone


if __name__ == "__main__":
    sys.path.pop(0)  # this folder, whose modules rospy must not find
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
