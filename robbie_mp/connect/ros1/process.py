"""The ROS 1 node's process, as the bridge sees it: started, watched, started again."""

import contextlib
import json
import logging
import math
import os
import socket
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from robbie_mp.connect.ros1 import ros_node
from robbie_mp.connect.ros1.conversion import Ros1Type
from robbie_mp.connect.ros1.ros_node import NodeFrame, frames, pack

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 2.0
MISSING_PAUSE_S = 30.0
"""Time until the next try when there is no Python, or no rospy."""
STABLE_S = 30.0
SILENT_S = 5.0
"""Time without a sign of life after which the node is killed: it says how it is four times a second."""
MAX_INBOX = 1000
MAX_INBOX_BYTES = 64 << 20


class RosAddress(NamedTuple):
    """Where the node is in a ROS system.

    Attributes:
        master: URI of the ROS master.
        ip: address under which other nodes find this one; it listens there only.
        name: its name.
        python: the Python that has rospy.
    """

    master: str
    ip: str
    name: str
    python: Path


class TopicWish(NamedTuple):
    """A topic that the node is to open.

    Attributes:
        topic: its name in ROS.
        kind: the type of its messages.
        is_latched: whether ROS keeps the newest message for later subscribers; of a subscriber, whether
            it gets what ROS has kept from before.
        depth: messages that may wait for each subscriber.
    """

    topic: str
    kind: Ros1Type
    is_latched: bool
    depth: int

    def packed(self) -> bytes:
        """Return it as the node reads it."""
        fields = {
            "topic": self.topic,
            "type": self.kind.name,
            "md5": self.kind.md5,
            "definition": self.kind.definition,
            "latched": self.is_latched,
            "depth": self.depth,
        }
        return json.dumps(fields).encode()


class AnnouncedType(NamedTuple):
    """What a ROS connection says about its messages, on a topic that takes messages of any type.

    Attributes:
        channel: the channel of the topic.
        type_name: name of their type in ROS 1.
        md5: its MD5 sum.
        definition: its text, with the texts of the types in it.
    """

    channel: int
    type_name: str
    md5: str
    definition: str


class NodeOutbox:
    """Frames on their way to the node. When it is slow, the oldest messages of the same channel go.

    Args:
        max_bytes: of all messages that wait.

    Attributes:
        dropped: number of messages that had to go.
    """

    def __init__(self, max_bytes: int):
        self._max_bytes = max_bytes
        self._condition = threading.Condition()
        self._orders: deque[bytes] = deque()
        self._messages: dict[int, deque[bytes]] = {}
        self._turns: deque[int] = deque()
        self._bytes = 0
        self._is_closed = False
        self.dropped = 0

    def order(self, frame: bytes) -> None:
        """Append a frame that must not be lost; it overtakes messages."""
        with self._condition:
            self._orders.append(frame)
            self._condition.notify()

    def push(self, channel: int, frame: bytes, depth: int) -> None:
        """Append a message, of which `depth` of its channel may wait."""
        with self._condition:
            waiting = self._messages.setdefault(channel, deque())
            if len(frame) > self._max_bytes:
                self.dropped += 1
                return
            while waiting and (len(waiting) >= depth or self._bytes + len(frame) > self._max_bytes):
                self._bytes -= len(waiting.popleft())
                self._turns.remove(channel)
                self.dropped += 1
            if self._bytes + len(frame) > self._max_bytes:
                self.dropped += 1
                return
            waiting.append(frame)
            self._turns.append(channel)
            self._bytes += len(frame)
            self._condition.notify()

    def pop(self) -> bytes | None:
        """Wait for the next frame; None: the outbox is closed."""
        with self._condition:
            while not (self._orders or self._turns or self._is_closed):
                self._condition.wait()
            if self._is_closed:
                return None
            if self._orders:
                return self._orders.popleft()
            frame = self._messages[self._turns.popleft()].popleft()
            self._bytes -= len(frame)
            return frame

    def close(self) -> None:
        """Count what waits as dropped, and end the wait in `pop`."""
        with self._condition:
            self._is_closed = True
            self.dropped += len(self._turns)
            self._condition.notify_all()


class NodeInbox:
    """Messages that have come from the node; when the bridge is slow, the oldest go.

    Attributes:
        dropped: number of messages that had to go.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._frames: deque[NodeFrame] = deque()
        self._bytes = 0
        self.dropped = 0

    def push(self, frame: NodeFrame) -> None:
        """Append a message."""
        size = len(frame.payload)
        with self._lock:
            while self._frames and (len(self._frames) >= MAX_INBOX or self._bytes + size > MAX_INBOX_BYTES):
                self._bytes -= len(self._frames.popleft().payload)
                self.dropped += 1
            self._frames.append(frame)
            self._bytes += size

    def take(self) -> list[NodeFrame]:
        """Return all messages that wait."""
        with self._lock:
            taken, self._bytes = list(self._frames), 0
            self._frames.clear()
        return taken


class _Session:
    """One process of the node, and the two threads that speak with it."""

    def __init__(
        self, address: RosAddress, max_bytes: int, on_frame: Callable[["_Session", NodeFrame], None]
    ):
        self.outbox = NodeOutbox(max_bytes)
        self.started_at = self.heard_at = time.monotonic()
        self.is_ready = False
        self.state: dict[str, Any] = {}
        self.channels: dict[int, int] = {}
        """The bridge's numbers of types by the node's."""
        self._on_frame = on_frame
        self._link, theirs = socket.socketpair()
        environment = {
            **os.environ,
            "ROS_MASTER_URI": address.master,
            "ROS_IP": address.ip,
            "ROS_PYTHON_LOG_CONFIG_FILE": os.devnull,
        }
        environment.pop("ROS_HOSTNAME", None)
        arguments = [str(theirs.fileno()), str(os.getpid()), address.name]
        command = [str(address.python), ros_node.__file__, *arguments]
        with theirs:
            try:
                self.process = subprocess.Popen(
                    command, env=environment, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()]
                )
            except OSError:
                self._link.close()
                raise
        self._threads = [
            threading.Thread(target=work, name=f"ros {work.__name__}", daemon=True)
            for work in (self._read, self._write)
        ]
        for thread in self._threads:
            thread.start()

    def _read(self) -> None:
        for frame in frames(self._link):
            self.heard_at = time.monotonic()
            self._on_frame(self, frame)

    def _write(self) -> None:
        while (frame := self.outbox.pop()) is not None:
            try:
                self._link.sendall(frame)
            except OSError:
                return

    def close(self) -> None:
        """End the process and the threads."""
        self.is_ready = False
        self.outbox.close()
        self.process.kill()
        self.process.wait()
        with contextlib.suppress(OSError):
            self._link.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()
        self._link.close()


class RosProcess:
    """Keeps a ROS node running beside the bridge, and passes messages to and from it.

    Nothing here waits for ROS, except `close`, which kills the node.

    Args:
        address: where the node is in ROS.
        max_bytes: of the messages that may wait for the node.
        log: where to log what happens to it.
        wake: called in another thread when messages have come.

    Attributes:
        listeners: number of ROS subscribers by channel.
        starts: how often the node was started.
        announced: the types of messages on topics that take any type, by the number under which they come.
    """

    def __init__(self, address: RosAddress, max_bytes: int, log: logging.Logger, wake: Callable[[], None]):
        self._address = address
        self._max_bytes = max_bytes
        self._log = log
        self._wake = wake
        self._lock = threading.Lock()
        self._wishes: dict[int, bytes] = {}
        self._depths: dict[int, int] = {}
        self._kept: dict[int, bytes] = {}
        self._inbox = NodeInbox()
        self._session: _Session | None = None
        self._pause_s = FIRST_PAUSE_S
        self._next_start = 0.0
        self._past_dropped = 0
        self._was_connected = False
        self._last_reason = ""
        self.listeners: dict[int, int] = {}
        self.starts = 0
        self.announced: dict[int, AnnouncedType] = {}

    # -- what is wanted

    def publish_on(self, channel: int, wish: TopicWish) -> None:
        """Have the node publish on a topic."""
        self._order(channel, pack(ros_node.PUBLISH, channel, wish.packed()), wish.depth)

    def subscribe_to(self, channel: int, wish: TopicWish) -> None:
        """Have the node subscribe to a topic."""
        self._order(channel, pack(ros_node.SUBSCRIBE, channel, wish.packed()), wish.depth)

    def set_parameters(self, values: Mapping[str, str]) -> None:
        """Have the node set parameters, now and whenever the master has been restarted."""
        self._order(0, pack(ros_node.PARAMETER, 0, json.dumps(values).encode()), 1)

    def _order(self, channel: int, frame: bytes, depth: int) -> None:
        with self._lock:
            self._wishes[channel] = frame
            self._depths[channel] = depth
            if self._session is not None and self._session.is_ready:
                self._session.outbox.order(frame)

    # -- messages

    def send(self, channel: int, data: bytes, *, keep: bool) -> None:
        """Send a message; `keep`: its topic is latched, so every process of the node gets the newest one."""
        frame = pack(ros_node.MESSAGE, channel, data)
        with self._lock:
            if keep:
                self._kept[channel] = frame
            if self._session is not None and self._session.is_ready:
                self._session.outbox.push(channel, frame, self._depths[channel])

    def received(self) -> Iterator[tuple[int, bytes, float]]:
        """Yield channel, data, and the greatest age (s) of each message that has come.

        The age counts from the arrival in ROS; of a message that may move the robot, from when it can have
        been sent at the earliest, and is infinite if that is not known.

        A message on a topic that takes any type comes under a number of `announced`. If there was no room for
        its type there, it comes under its channel.
        """
        for frame in self._inbox.take():
            age_s = (time.monotonic_ns() - frame.sent_ns) / 1e9 if frame.sent_ns else math.inf
            yield frame.channel, frame.payload, age_s

    # -- the process

    @property
    def pid(self) -> int:
        """The node's process; 0 if there is none."""
        return self._session.process.pid if self._session is not None else 0

    @property
    def is_connected(self) -> bool:
        """Whether the node runs and the ROS master is there."""
        session = self._session
        return session is not None and session.is_ready and bool(session.state.get("master"))

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped on their way, in either direction, because a side was slow."""
        session = self._session
        now = session.outbox.dropped + session.state.get("dropped", 0) if session is not None else 0
        return self._past_dropped + self._inbox.dropped + now

    def look_after(self) -> None:
        """Start the node if it is time, and kill it if it says nothing any more; call this often."""
        now = time.monotonic()
        session = self._session
        if session is None:
            if now >= self._next_start:
                self._start()
            return
        if session.process.poll() is not None:
            self._end(_why(session.process.returncode, self._address))
        elif now - session.heard_at > SILENT_S:
            self._end(f"the ROS node has said nothing for {SILENT_S} s")
        elif session.is_ready and now - session.started_at > STABLE_S:
            self._pause_s = FIRST_PAUSE_S
        if self.is_connected != self._was_connected:
            self._was_connected = self.is_connected
            there = "has" if self._was_connected else "does not have"
            self._log.info("the ROS node %s the master at %s", there, self._address.master)

    def close(self) -> None:
        """End the node."""
        session = self._session
        if session is not None:
            session.close()
            self._session = None

    def _start(self) -> None:
        self.starts += 1
        self._next_start = time.monotonic() + self._pause_s
        try:
            self._session = _Session(self._address, self._max_bytes, self._on_frame)
        except OSError as error:
            self._next_start = time.monotonic() + MISSING_PAUSE_S
            self._say_once(f"the ROS node cannot be started: {error}")

    def _end(self, reason: str) -> None:
        session = self._session
        assert session is not None
        self._say_once(f"{reason}; it is started again")
        with self._lock:
            self._session = None
            self.listeners = {}
        session.close()
        self._past_dropped += session.outbox.dropped + session.state.get("dropped", 0)
        is_missing = session.process.returncode == ros_node.NO_ROSPY
        self._next_start = time.monotonic() + (MISSING_PAUSE_S if is_missing else self._pause_s)
        self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)

    def _say_once(self, reason: str) -> None:
        """Log why there is no ROS node, unless that was logged last."""
        if reason != self._last_reason:
            self._last_reason = reason
            self._log.warning("%s", reason)

    def _on_frame(self, session: _Session, frame: NodeFrame) -> None:
        if frame.kind == ros_node.MESSAGE:
            channel = session.channels.get(frame.channel, frame.channel)
            self._inbox.push(frame._replace(channel=channel))
            self._wake()
        elif frame.kind == ros_node.ANNOUNCE:
            session.channels[frame.channel] = self._number(AnnouncedType(**json.loads(frame.payload)))
        elif frame.kind == ros_node.STATE:
            session.state = json.loads(frame.payload)
            listeners = session.state.get("listeners", {})
            self.listeners = {int(channel): count for channel, count in listeners.items()}
        elif frame.kind == ros_node.READY:
            with self._lock:
                for wish in self._wishes.values():
                    session.outbox.order(wish)
                for channel, kept in self._kept.items():
                    session.outbox.push(channel, kept, self._depths[channel])
                session.is_ready = True

    def _number(self, announced: AnnouncedType) -> int:
        """Return the number for messages of a type, which it keeps when the node is started again."""
        for number, known in self.announced.items():
            if known == announced:
                return number
        if len(self.announced) >= ros_node.MAX_ANNOUNCED:
            return announced.channel
        number = ros_node.FIRST_ANNOUNCED + len(self.announced)
        self.announced[number] = announced
        return number


def _why(code: int, address: RosAddress) -> str:
    """Return why the node has ended."""
    if code == ros_node.NO_ROSPY:
        return f"{address.python} has no rospy; docs/ros1.md says how to install it"
    if code == ros_node.NAME_TAKEN:
        return f"another ROS node has taken the name {address.name}"
    return f"the ROS node has ended with {code}"
