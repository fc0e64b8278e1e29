"""The network under a link: a session of Zenoh, which carries packets between robots by their names.

Zenoh calls back in its own threads. If nobody else works with the link, they hand a packet over at once;
otherwise they put it into a queue of limited size, and wake the module.
"""

import json
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.extras import how_to_install
from robbie_mp.connect.link.header import (
    MAX_HEADER_BYTES,
    PART_BYTES,
    ROBOT_NAME,
    Beat,
    DataHeader,
    ReceivedPacket,
    ReceiverReport,
    pack,
)
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.connect.link.turns import Turns

if TYPE_CHECKING:
    import zenoh

ROOT = "robbie"
PACKETS = f"{ROOT}/link"
"""Packets have the key robbie/link/RECEIVER/SENDER."""
DATAGRAMS = f"{ROOT}/datagram"
"""Those that are sent as datagrams have the key robbie/datagram/RECEIVER/SENDER."""
ROBOTS = f"{ROOT}/robot"
"""Each link announces itself with a key robbie/robot/NAME/SESSION.NUMBER while it lives."""
SPELLINGS = (f"{ROOT}$*", f"$*{ROOT}")
"""A link subscribes with one of these patterns for the root of the keys, in turn.

Zenoh sends the beginning of a key in full only once on a connection, and then a number for it, even if the
network has lost the first. What begins with a pattern has no number.
"""
DECLARE_NS = 500_000_000
"""Least time after which a link declares again what it has declared."""
RECEIVING_THREADS = 8
"""Threads of Zenoh that receive, in one process.

With the usual two, Zenoh often did not notice the end of one of several connections while there was no
network. Then one robot went on with the old connections, and the other began with new ones: in 7 of 10 cuts,
nothing came for 2.5 to 11 s more. With eight, it was at most 1.3 s in 9 cuts.
"""
LEASE_MS = 4000
OPEN_MS = 2000
"""How long Zenoh tries to open a connection before it begins again: its greeting may be lost."""
STREAMS = ("0-4", "5-5", "6-7")
"""Two links have a stream for each of these ranges of Zenoh's priorities: urgent, reliable, and bulk."""
MAX_WAYS = 2 * (len(STREAMS) + 1)
"""Connections between two links: the streams and one for datagrams, and those that end."""
SEVERAL_WAYS = {
    "transport/unicast/max_links": MAX_WAYS,
    "transport/unicast/open_timeout": OPEN_MS,
    "transport/unicast/accept_timeout": OPEN_MS,
}
QUEUED_BATCHES = 16
"""Batches of 64 kB that Zenoh may queue for each priority."""
ROOM_US = 5_000
"""How long Zenoh waits for room in its queue before it throws a packet away,"""
MAX_ROOM_US = 10_000
"""and for all batches of a packet."""
FIND_S = 2.0


class LinkUnavailable(RobbieError, RuntimeError):
    """A link cannot be opened.

    Example scenarios:
      - the extra `link` is not installed
      - the address to listen on is taken or is not one of this machine
    """


@dataclass(frozen=True)
class Endpoints:
    """How links find one another.

    Attributes:
        mode: `peer`, or `client` of a router.
        listen: addresses to listen on, as `tcp/127.0.0.1:7447`.
        connect: addresses of other robots or of a router.
        multicast: whether to look for others by multicast.
        datagrams: whether links also connect over UDP, at the same ports.
        further: further settings of Zenoh by their path, as `transport/link/tls`.
    """

    mode: str = "peer"
    listen: Sequence[str] = ()
    connect: Sequence[str] = ()
    multicast: bool = False
    datagrams: bool = False
    further: Mapping[str, Any] = field(default_factory=dict)


class InboxLimits(NamedTuple):
    """How much may wait until the module takes it; what is more is dropped and counted."""

    packets: int
    bytes: int


def ways(endpoints: Endpoints, addresses: Sequence[str], *, listens: bool = False) -> list[str]:
    """Return addresses with their ways: streams, and datagrams past them at the same port.

    An address with options of Zenoh (after `?` or `#`) stays as it is. Clients of a router have one way only.

    Args:
        endpoints: how links find one another.
        addresses: those of `endpoints` to listen on, or to connect to.
        listens: whether to listen on them: all streams come in at one address.
    """
    found: list[str] = []
    for address in addresses:
        protocol, _, place = address.partition("/")
        beside = {"tcp": "udp", "tls": "quic"}.get(protocol)
        if not endpoints.datagrams or endpoints.mode != "peer" or beside is None or set("?#") & set(address):
            found.append(address)
        else:
            streams = [""] if listens else [f";prio={priorities}" for priorities in STREAMS]
            found += [f"{address}?rel=1{priorities}" for priorities in streams] + [f"{beside}/{place}?rel=0"]
    return found


def has_quic(endpoints: Endpoints) -> bool:
    """Return whether datagrams go over QUIC."""
    addresses = (*endpoints.listen, *endpoints.connect)
    return any(way.startswith("quic/") for way in ways(endpoints, addresses))


def only_own_names(robot: str, trusted: Iterable[str]) -> dict[str, object]:
    """Return the setting of Zenoh with which a robot with a certificate cannot send under another one's name.

    Args:
        robot: the name of this robot.
        trusted: the names in the certificates of the robots that may connect.
    """

    def rule(name: str, flow: str, messages: Sequence[str], *keys: str) -> dict[str, object]:
        return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}

    asks = ("declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber")
    says = ("put", "delete", "reply", "liveliness_token")
    all_keys = [f"{beginning}/**" for beginning in (ROOT, *SPELLINGS)]
    rules = [
        rule("out", "egress", (*asks, *says), *all_keys),
        rule("asks", "ingress", asks, *all_keys),
    ]
    subjects: list[dict[str, object]] = [{"id": "all"}]
    policies = [{"rules": ["out", "asks"], "subjects": ["all"]}]
    for other in trusted:
        keys = (f"{PACKETS}/{robot}/{other}", f"{DATAGRAMS}/{robot}/{other}", f"{ROBOTS}/{other}/*")
        rules.append(rule(f"from {other}", "ingress", says, *keys))
        subjects.append({"id": other, "cert_common_names": [other]})
        policies.append({"rules": [f"from {other}"], "subjects": [other]})
    control = {"rules": rules, "subjects": subjects, "policies": policies}
    return {"access_control": {"enabled": True, "default_permission": "deny", **control}}


def open_session(endpoints: Endpoints) -> "zenoh.Session":
    """Open a session of Zenoh.

    Raises:
        LinkUnavailable: Zenoh is not installed, or cannot listen.
    """
    try:
        import zenoh  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise LinkUnavailable(f"a link needs the extra `link`: {how_to_install('link')}") from error
    os.environ.setdefault("ZENOH_RUNTIME", f"(rx: (worker_threads: {RECEIVING_THREADS}))")
    config = zenoh.Config()
    queues = ("real_time", "interactive_high", "data_high", "data", "data_low")
    values: dict[str, object] = {
        "mode": endpoints.mode,
        "listen/endpoints": ways(endpoints, endpoints.listen, listens=True),
        "listen/exit_on_failure": True,
        "connect/endpoints": ways(endpoints, endpoints.connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5},
        "scouting/multicast/enabled": endpoints.multicast,
        "scouting/gossip/enabled": False,
        "open/return_conditions/connect_scouted": endpoints.multicast,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/rx/max_message_size": PART_BYTES + 2 * MAX_HEADER_BYTES,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": ROOM_US,
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": MAX_ROOM_US,
        **{f"transport/link/tx/queue/size/{queue}": QUEUED_BATCHES for queue in queues},
        **(SEVERAL_WAYS if endpoints.datagrams else {}),
        **endpoints.further,
    }
    for path, value in values.items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            raise LinkUnavailable(f"Zenoh does not take {value!r} for {path}: {error}") from error
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        listening = ways(endpoints, endpoints.listen, listens=True)
        raise LinkUnavailable(
            f"cannot listen on {', '.join(listening) or 'any address'} or connect to "
            f"{', '.join(endpoints.connect) or 'nobody'}: {error}"
        ) from error


class Wire:
    """Carries packets.

    Args:
        robot: the name of this robot.
        session: number of this process's session.
        endpoints: how to find others.
        limits: what may wait for the module.
        wake: called in another thread when packets wait.

    Attributes:
        overflowed: packets dropped because too many waited.
        oversized: packets that no link sends, because they are too large, or have no header.
        joins_datagrams: whether datagrams that are sent at once may go in one packet: QUIC does that.
        turns: what works with what `take_at_once` works with must have a turn.

    Raises:
        LinkUnavailable: as for `open_session`.
    """

    def __init__(
        self,
        robot: str,
        session: int,
        endpoints: Endpoints,
        limits: InboxLimits,
        wake: Callable[[], None],
    ):
        self._robot = robot
        self._zenoh = open_session(endpoints)
        import zenoh  # noqa: PLC0415 - an extra

        self._error = zenoh.ZError
        self._limits = limits
        self._wake = wake
        self._take: Callable[[ReceivedPacket], None] | None = None
        self._failure: Exception | None = None
        """What an exception in a thread of Zenoh was."""
        self._inbox: deque[ReceivedPacket] = deque()
        self._inbox_bytes = 0
        self._inbox_lock = threading.Lock()
        self.turns = Turns()
        self._seen: deque[str] = deque(maxlen=256)
        self._publishers: dict[tuple[str, int, bool, bool], zenoh.Publisher] = {}
        self.overflowed = 0
        self.oversized = 0
        self.joins_datagrams = has_quic(endpoints)
        self._session = session
        self._said: list[zenoh.Subscriber[None] | zenoh.LivelinessToken] = []
        """What has been declared that others must know."""
        self._times_said, self._said_ns = 0, 0
        self._has_new_stream = False
        self._declare_itself()
        self._listens = [
            self._zenoh.liveliness().declare_subscriber(f"{ROBOTS}/*/*", self._on_robot, history=True),
            self._zenoh.info.declare_link_events_listener(self._on_way, history=True),
        ]

    def send(
        self,
        robot: str,
        packet: DataHeader | ReceiverReport | Beat,
        payload: memoryview | bytes,
        *,
        as_datagram: bool = False,
        at_once: bool = False,
    ) -> None:
        """Send a packet; it may be lost without a word. A stream carries datagrams if nothing else does."""
        traffic = packet.traffic if isinstance(packet, DataHeader) else -1
        key = (robot, traffic, as_datagram, at_once or traffic <= TrafficClass.STATE)
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._declare(*key)
        data, header = payload if type(payload) is bytes else bytes(payload), pack(packet)
        with suppress(self._error):  # it counts as lost
            publisher.put(data, attachment=header)

    def take_at_once(self, take: Callable[[ReceivedPacket], None] | None) -> None:
        """From now on, call a function with packets, in threads of Zenoh; None: keep them for `received`.

        The function has the turn. What arrives while another thread has it, waits for `received`.
        """
        with self.turns:
            self._take = take

    def received(self) -> Iterator[ReceivedPacket]:
        """Take what waits.

        Raises:
            Exception: what a function given to `take_at_once` has raised.
        """
        if self._failure is not None:
            raise self._failure
        inbox = self._inbox
        for _ in range(len(inbox)):
            one = inbox.popleft()
            with self._inbox_lock:
                self._inbox_bytes -= _size(one)
            yield one

    def seen(self) -> Iterator[str]:
        """Take the names of robots that have come since the last call."""
        for _ in range(len(self._seen)):
            yield self._seen.popleft()

    def look_after(self, now_ns: int) -> None:
        """Declare again what others must know, if a new stream has come up; call this every few ms.

        Where the way for datagrams comes up before any stream, Zenoh declares over it. What the network loses
        of that, it does not repeat, so the other link would never send anything here.
        """
        if self._has_new_stream and now_ns - self._said_ns >= DECLARE_NS:
            self._has_new_stream, self._said_ns = False, now_ns
            self._declare_itself()

    @property
    def something_waits(self) -> bool:
        """Whether packets wait."""
        return bool(self._inbox) or self._failure is not None

    def close(self) -> None:
        """End the session; nothing is called back any more."""
        self._zenoh.close()

    def _declare_itself(self) -> None:
        """Declare where this link receives and that it lives, with other keys than the last time."""
        import zenoh  # noqa: PLC0415

        on_sample = zenoh.handlers.Callback(self._on_sample, indirect=False)
        number = self._times_said % len(SPELLINGS)
        before = self._said
        self._said = [
            self._zenoh.liveliness().declare_token(f"{ROBOTS}/{self._robot}/{self._session:x}.{number}")
        ]
        for keys in (PACKETS, DATAGRAMS):
            spelled = keys.replace(ROOT, SPELLINGS[number])
            self._said.append(self._zenoh.declare_subscriber(f"{spelled}/{self._robot}/*", on_sample))
        self._times_said += 1
        for one in before:
            one.undeclare()

    def _declare(self, robot: str, traffic: int, as_datagram: bool, is_express: bool) -> "zenoh.Publisher":
        import zenoh  # noqa: PLC0415

        priorities: dict[int, zenoh.Priority] = {
            TrafficClass.URGENT: zenoh.Priority.REAL_TIME,
            TrafficClass.COMMAND: zenoh.Priority.REAL_TIME,
            TrafficClass.STATE: zenoh.Priority.DATA_HIGH,
            TrafficClass.RELIABLE: zenoh.Priority.DATA,
            TrafficClass.BULK: zenoh.Priority.DATA_LOW,
        }
        priority = priorities.get(traffic, zenoh.Priority.INTERACTIVE_HIGH)
        return self._zenoh.declare_publisher(
            f"{DATAGRAMS if as_datagram else PACKETS}/{robot}/{self._robot}",
            priority=priority,
            congestion_control=zenoh.CongestionControl.DROP,
            express=is_express,
            reliability=zenoh.Reliability.BEST_EFFORT if as_datagram else zenoh.Reliability.RELIABLE,
        )

    # -- in threads of Zenoh ---------------------------------------------------------------------------

    def _on_sample(self, sample: "zenoh.Sample") -> None:
        at_ns = time.monotonic_ns()
        header, payload = sample.attachment, sample.payload
        if header is None or len(header) > MAX_HEADER_BYTES or len(payload) > PART_BYTES:
            with self._inbox_lock:
                self.oversized += 1
            return
        key = str(sample.key_expr)
        robot, is_datagram = key.rpartition("/")[2], key.startswith(DATAGRAMS)
        one = ReceivedPacket(robot, header.to_bytes(), payload.to_bytes(), at_ns, is_datagram)
        if self._take is not None and not self._inbox and self.turns.begin_at_once():
            try:
                if self._take is not None:  # nobody changes it during this turn
                    self._take(one)
                    return
            except Exception as error:
                self._failure, self._take = error, None
                self._wake()
                return
            finally:
                self.turns.end()
        with self._inbox_lock:
            size, limits = _size(one), self._limits
            if len(self._inbox) >= limits.packets or self._inbox_bytes + size > limits.bytes:
                self.overflowed += 1
                return
            self._inbox_bytes += size
            self._inbox.append(one)
        self._wake()

    def _on_robot(self, sample: "zenoh.Sample") -> None:
        import zenoh  # noqa: PLC0415

        if sample.kind == zenoh.SampleKind.PUT:
            self._seen.append(str(sample.key_expr).split("/")[-2])
            self._wake()

    def _on_way(self, event: "zenoh.LinkEvent") -> None:
        import zenoh  # noqa: PLC0415

        if event.kind == zenoh.SampleKind.PUT and event.link.reliability != zenoh.Reliability.BEST_EFFORT:
            self._has_new_stream = True


def _size(packet: ReceivedPacket) -> int:
    return len(packet.header) + len(packet.payload)


def find_robots(endpoints: Endpoints) -> list[str]:
    """Return the names of the robots whose links can be reached, sorted.

    Raises:
        LinkUnavailable: as for `open_session`.
    """
    session = open_session(endpoints)
    names: set[str] = set()
    end_s = time.monotonic() + FIND_S
    try:
        while time.monotonic() < end_s and not names:
            for reply in session.liveliness().get(f"{ROBOTS}/*/*", timeout=0.5):
                if reply.ok is not None:
                    name = str(reply.ok.key_expr).split("/")[-2]
                    names |= {name} if ROBOT_NAME.fullmatch(name) else set()
    finally:
        session.close()
    return sorted(names)
