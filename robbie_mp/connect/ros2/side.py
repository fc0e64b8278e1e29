"""The interface between the bridge to ROS 2 and each middleware."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple, Protocol

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.bridge.mapping import Quality

if TYPE_CHECKING:
    from robbie_mp.connect.ros2.service_types import ServiceType

MAX_DOMAIN = 232
"""The largest ROS_DOMAIN_ID."""
CLOCKS_DIFFER_S = 0.1
"""Most by which a message may come from the future: then the clocks differ, and do not tell its age."""
MAX_LARGEST = 4
"""All that waits until the module takes it has at most this many times the bytes of the largest message."""
MAX_CALLS = 64
"""Most requests that wait until the module takes them; the clients of further ones get no response."""

RESPONSE_LIMIT_S = 60.0
"""After this time, a request to ROS without response has ended, unless its caller says another one."""


class Ros2Unavailable(RobbieError, RuntimeError):
    """The bridge to ROS 2 cannot work.

    Example scenarios:
      - the extra `ros2` is not installed
      - the address to listen on is taken, or the network interface does not exist
    """


class NodeName(NamedTuple):
    """The node as which the robot appears in ROS 2.

    Attributes:
        domain: the ROS_DOMAIN_ID.
        namespace: "/", or for example "/red".
        name: the node's name.
    """

    domain: int
    namespace: str
    name: str


class RosChannel(NamedTuple):
    """A topic of ROS 2 with its type.

    Attributes:
        name: the topic, with a slash before it.
        type_name: as `sensor_msgs/msg/LaserScan`.
        type_hash: as `RIHS01_…`.
        quality: its quality of service.
    """

    name: str
    type_name: str
    type_hash: str
    quality: Quality

    @property
    def dds_type(self) -> str:
        """The type's name in DDS and Zenoh, as `sensor_msgs::msg::dds_::LaserScan_`."""
        package, kind, name = self.type_name.split("/")
        return f"{package}::{kind}::dds_::{name}_"


class RosArrival(NamedTuple):
    """A message from ROS 2; nothing in it has been checked, except for its size.

    Attributes:
        channel: the channel that it was asked for by.
        data: the encoded message.
        age_s: its age when it arrived, by the clocks of both machines; infinite if they do not tell it.
        at_ns: when it arrived, by the machine's monotonic clock.
    """

    channel: RosChannel
    data: bytes
    age_s: float
    at_ns: int

    @property
    def waited_s(self) -> float:
        """How long ago it was sent, s."""
        return self.age_s + (time.monotonic_ns() - self.at_ns) * 1e-9


class Call(NamedTuple):
    """A request from ROS 2; nothing in it has been checked, except for its size.

    Attributes:
        service: the name of the service.
        data: the encoded request.
        sent_at_ns: when it was sent, by the machine's monotonic clock; when it arrived if its sender does not
            say; -inf if the clocks of both machines differ too much to tell.
        answer: sends the encoded response; in the module's thread, once.
    """

    service: str
    data: bytes
    sent_at_ns: float
    answer: Callable[[bytes], None]


class MiddlewareInbox:
    """Messages and requests that threads of a middleware have received, until the module takes them.

    Args:
        max_messages: messages that may wait; further ones are dropped and counted.
        max_bytes: size of the largest message that is taken.
        wake: called in another thread when messages wait.

    Attributes:
        max_bytes: size of the largest message that is taken.
        overflowed: messages dropped because too many waited.
        oversized: messages dropped because they were too large.
        strangers: messages of a type, or with a type hash, that was not asked for, by what they are.
    """

    def __init__(self, max_messages: int, max_bytes: int, wake: Callable[[], None]):
        self._max_messages, self.max_bytes, self._wake = max_messages, max_bytes, wake
        self._lock = threading.Lock()
        self._waiting_bytes = 0
        self._waiting: deque[RosArrival] = deque()
        self._calls: deque[Call] = deque()
        self.overflowed = 0
        self.oversized = 0
        self.strangers = 0
        self.taps: dict[RosChannel, Callable[[bytes, int, bytes], None]] = {}
        """What takes the messages of a channel at once, in any thread, with the machine's time in ns and the
        publisher."""
        self.unnamed: deque[str] = deque(maxlen=32)
        """Descriptions of strangers, for the module to name in its log; the oldest go first."""

    def put(
        self, channel: RosChannel, data: bytes, sent_ns: int, sender: bytes = b"", came_ns: int = 0
    ) -> None:
        """Keep a message for the module; in any thread.

        Args:
            channel: the channel that it was asked for by.
            data: the encoded message.
            sent_ns: when its sender says that it has sent it, ns since 1970.
            sender: the publisher; empty: not known.
            came_ns: when it arrived, by the machine's monotonic clock; 0: now.
        """
        came_ns = came_ns or time.monotonic_ns()
        if len(data) > self.max_bytes:
            self.oversized += 1
        elif tap := self.taps.get(channel):
            tap(data, came_ns, sender)
        elif len(self._waiting) >= self._max_messages or not self._takes(len(data)):
            self.overflowed += 1
        else:
            self._waiting.append(RosArrival(channel, data, _age_s(sent_ns, came_ns), came_ns))
            self._wake()

    def put_call(
        self,
        service: str,
        data: bytes,
        answer: Callable[[bytes], None],
        sent_ns: int | None = None,
        came_ns: int = 0,
    ) -> None:
        """Keep a request for the module, and when its sender says that it has sent it; in any thread."""
        if len(data) > self.max_bytes:
            self.oversized += 1
        elif len(self._calls) >= MAX_CALLS or not self._takes(len(data)):
            self.overflowed += 1
        else:
            came_ns = came_ns or time.monotonic_ns()
            age_s = 0.0 if sent_ns is None else _age_s(sent_ns, came_ns)
            self._calls.append(Call(service, data, came_ns - age_s * 1e9, answer))
            self._wake()

    def count_oversized(self) -> None:
        """Count a message that was too large to be put; in any thread."""
        self.oversized += 1

    def put_stranger(self, what: str) -> None:
        """Count a message that was not asked for; in any thread."""
        self.strangers += 1
        self.unnamed.append(what)

    def take(self) -> Iterator[RosArrival]:
        """Take what waits now."""
        for _ in range(len(self._waiting)):
            taken = self._waiting.popleft()
            self._gives(len(taken.data))
            yield taken

    def take_calls(self) -> Iterator[Call]:
        """Take the requests that wait now."""
        for _ in range(len(self._calls)):
            taken = self._calls.popleft()
            self._gives(len(taken.data))
            yield taken

    def _takes(self, size: int) -> bool:
        """Whether there is room for further bytes, which are then counted."""
        with self._lock:
            has_room = self._waiting_bytes + size <= MAX_LARGEST * self.max_bytes
            self._waiting_bytes += size * has_room
        return has_room

    def _gives(self, size: int) -> None:
        with self._lock:
            self._waiting_bytes -= size


def _age_s(sent_ns: int, came_ns: int) -> float:
    """Return the age of a message that has arrived; infinite if the sender's clock is not as this one."""
    age_s = (time.time_ns() - (time.monotonic_ns() - came_ns) - sent_ns) * 1e-9
    return max(0.0, age_s) if age_s > -CLOCKS_DIFFER_S else math.inf


class ReusedMemory:
    """Memory for copies of large messages: the pages that the system would give for each cost more."""

    def __init__(self) -> None:
        self._memory = bytearray()

    def copy(self, data: memoryview | bytes) -> bytearray:
        """Return a copy, which is valid until the next call."""
        missing = len(data) - len(self._memory)
        if missing > 0:
            self._memory += bytes(missing)
        else:
            del self._memory[len(data) :]
        with memoryview(self._memory) as view:
            view[:] = data
        return self._memory


class Side(Protocol):
    """A middleware of ROS 2, with the robot as one node in it."""

    @property
    def unsent(self) -> int:
        """Messages that the middleware did not take."""

    incompatible: int
    """Endpoints of others that do not fit because of their quality of service."""

    refusal: str
    """Which matching publishers the middleware ignores, and what to do; '' if there are none."""

    def send(self, channel: RosChannel, data: memoryview | bytes) -> None:
        """Send a message; the first on a channel announces a publisher. It does not wait for anybody."""

    def announce(self, channel: RosChannel) -> None:
        """Announce a publisher before it has anything to send."""

    def listen(self, channel: RosChannel) -> None:
        """Ask for the messages of a channel; they come into the inbox."""

    def serve(self, name: str, service: "ServiceType") -> None:
        """Offer a service; requests come into the inbox."""

    def join(self, name: str, service: "ServiceType", group: str = "") -> None:
        """Prepare to call a service of ROS.

        Args:
            name: its name.
            service: its type.
            group: services with this name are called only where one node serves them all; "": it is alone.
        """

    def call(
        self,
        name: str,
        data: bytes,
        done: Callable[[bytes | str], None],
        limit_s: float = RESPONSE_LIMIT_S,
    ) -> None:
        """Call a service of ROS that was joined.

        Args:
            name: its name.
            data: the encoded request.
            done: called once, in any thread, with the encoded response, or a text that says what is wrong.
            limit_s: time for the response, s.
        """

    def look_after(self) -> None:
        """Do what is due; called a few times in a second."""

    def close(self) -> None:
        """Leave; nothing comes into the inbox any more."""
