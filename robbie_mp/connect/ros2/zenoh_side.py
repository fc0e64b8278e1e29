"""ROS 2 over Zenoh, as nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp speak it.

Zenoh calls back in its own threads. They only put messages into the inbox.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from robbie_mp.base.extras import how_to_install
from robbie_mp.connect.bridge.mapping import Quality
from robbie_mp.connect.link.wire import Endpoints, LinkUnavailable, open_session
from robbie_mp.connect.ros2.nodes import Admission
from robbie_mp.connect.ros2.side import (
    RESPONSE_LIMIT_S,
    MiddlewareInbox,
    NodeName,
    ReusedMemory,
    Ros2Unavailable,
    RosChannel,
)
from robbie_mp.connect.ros2.tokens import (
    CLIENT,
    PUBLISHER,
    SERVICE,
    SUBSCRIPTION,
    Attachment,
    EndpointToken,
    any_token,
    any_type_key,
    data_key,
    endpoint_token,
    gid,
    node_token,
)

if TYPE_CHECKING:
    import zenoh

    from robbie_mp.connect.ros2.service_types import ServiceType

LARGE_BYTES = 1 << 16
"""Size from which a message fills Zenoh's batches: waiting for more to send with its end only costs time."""
LONGEST_S = 30 * 86400.0
"""Zenoh wants a limit for each request."""
ROUTER = "tcp/127.0.0.1:7447"
"""Where `ros2 run rmw_zenoh_cpp rmw_zenohd` listens."""


@dataclass
class _Publisher:
    """A declared publisher, and what it has sent. Large messages have one that does not wait for more."""

    zenoh: Any
    large: Any
    token: "zenoh.LivelinessToken"
    gid: bytes
    sent: int = 0


@dataclass
class _Client:
    """A service of ROS that this node calls."""

    key: str
    gid: bytes
    sent: int = 0


@dataclass
class ZenohSide:
    """The robot as a node of rmw_zenoh: a peer that finds others with the help of a router.

    Without a router it goes on, and tries again. It listens, by default on this machine only, because nodes
    connect to one another directly.

    Args:
        node: the node's name.
        inbox: where messages go.
        listen: addresses to listen on.
        connect: addresses of routers.
        max_bytes: size of the largest message from the network.
        admission: which nodes it deals with.

    Raises:
        Ros2Unavailable: a package is missing, or Zenoh cannot listen.
    """

    node: NodeName
    inbox: MiddlewareInbox
    listen_on: Sequence[str] = ("tcp/127.0.0.1:0",)
    connect: Sequence[str] = (ROUTER,)
    max_bytes: int = 64 << 20
    admission: Admission = field(default_factory=lambda: Admission(["*"], 0))
    unsent: int = 0
    incompatible: int = 0
    """None is: in Zenoh, every quality of service fits every other one."""
    refusal: str = ""
    """Nobody is refused either."""
    withheld: int = 0
    """Messages of this node that came back."""
    _publishers: dict[RosChannel, _Publisher] = field(default_factory=dict)
    _clients: dict[str, _Client] = field(default_factory=dict)
    _declared: list[Any] = field(default_factory=list)
    _gids: set[bytes] = field(default_factory=set)
    _memory: ReusedMemory = field(default_factory=ReusedMemory)
    """Zenoh takes no view, and copies what it takes."""

    def __post_init__(self) -> None:
        try:
            import xxhash  # noqa: F401, PLC0415
            import zenoh  # noqa: F401, PLC0415
        except ImportError as error:
            raise Ros2Unavailable(
                f"the bridge to ROS 2 needs the extra `ros2`: {how_to_install('ros2')}"
            ) from error
        further = {
            "scouting/gossip/enabled": True,
            "timestamping/enabled": True,
            "transport/link/rx/max_message_size": self.max_bytes + (64 << 10),
        }
        try:
            self._zenoh = open_session(
                Endpoints("peer", self.listen_on, self.connect, multicast=False, further=further)
            )
        except LinkUnavailable as error:
            raise Ros2Unavailable(str(error)) from error
        self._id = str(self._zenoh.zid())
        self._entities = 0
        liveliness = self._zenoh.liveliness()
        self._declared.append(liveliness.declare_token(node_token(self._id, self.node)))
        if not self.admission.is_open:
            tokens = any_token(self.node.domain)
            self._declared.append(liveliness.declare_subscriber(tokens, self._on_token, history=True))

    @property
    def zenoh_id(self) -> str:
        """The session's number, as it stands in tokens."""
        return self._id

    def send(self, channel: RosChannel, data: memoryview | bytes) -> None:
        """Send a message; the first on a channel announces a publisher."""
        import zenoh  # noqa: PLC0415

        self.announce(channel)
        publisher = self._publishers[channel]
        publisher.sent += 1
        attachment = Attachment(publisher.sent, time.time_ns(), publisher.gid).encode()
        own = publisher.large if len(data) >= LARGE_BYTES else publisher.zenoh
        try:
            own.put(self._memory.copy(data), attachment=attachment)
        except zenoh.ZError:
            self.unsent += 1

    def announce(self, channel: RosChannel) -> None:
        """Announce a publisher before it has anything to send."""
        if channel not in self._publishers:
            self._publishers[channel] = self._declare(channel)

    def listen(self, channel: RosChannel) -> None:
        """Ask for the messages of a channel, whichever type they have: those of others are counted."""
        import zenoh.ext  # noqa: PLC0415

        key = data_key(self.node.domain, channel)

        def on_sample(sample: "zenoh.Sample") -> None:
            self._on_sample(channel, key, sample)

        pattern = any_type_key(self.node.domain, channel)
        remote = zenoh.Locality.REMOTE
        if channel.quality.is_latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=channel.quality.depth)
            subscriber = zenoh.ext.declare_advanced_subscriber(
                self._zenoh, pattern, on_sample, allowed_origin=remote, history=history
            )
        else:
            subscriber = self._zenoh.declare_subscriber(pattern, on_sample, allowed_origin=remote)
        self._declared += [subscriber, self._token(SUBSCRIPTION, channel)[1]]

    def serve(self, name: str, service: "ServiceType") -> None:
        """Offer a service. Its queryable is complete, because nodes ask no other ones."""
        # A service of rmw_zenoh has a key and a token as a topic has.
        channel = RosChannel(name, service.name, service.type_hash, Quality())
        key = data_key(self.node.domain, channel)

        def on_query(query: "zenoh.Query") -> None:
            self._on_query(name, key, query)

        served = self._zenoh.declare_queryable(key, on_query, complete=True)
        self._declared += [served, self._token(SERVICE, channel)[1]]

    def join(self, name: str, service: "ServiceType", group: str = "") -> None:
        """Prepare to call a service of ROS. A request reaches all nodes that serve it, whatever its group."""
        channel = RosChannel(name, service.name, service.type_hash, Quality())
        token, declared = self._token(CLIENT, channel)
        self._declared.append(declared)
        self._clients[name] = _Client(data_key(self.node.domain, channel), gid(token))

    def call(
        self,
        name: str,
        data: bytes,
        done: "Callable[[bytes | str], None]",
        limit_s: float = RESPONSE_LIMIT_S,
    ) -> None:
        """Call a service of ROS; Zenoh says by itself when there is no response any more."""
        import zenoh  # noqa: PLC0415

        client = self._clients[name]
        client.sent += 1
        answers: list[bytes] = []

        def on_reply(reply: "zenoh.Reply") -> None:
            replier = reply.replier_id
            server = _server(str(replier.zid), name) if replier is not None else b""
            if reply.ok is None or answers:
                return
            if self.admission.admits(server):
                answers.append(reply.ok.payload.to_bytes())
            else:
                self.admission.refuse(server, f"a response of {name}")

        def on_end() -> None:
            done(answers[0] if answers else f"no node serves {name}, or it has gone")

        self._zenoh.get(
            client.key,
            handler=zenoh.handlers.Callback(on_reply, on_end),
            payload=data,
            attachment=Attachment(client.sent, time.time_ns(), client.gid).encode(),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=min(limit_s, LONGEST_S),
        )

    def look_after(self) -> None:
        """Refuse what has waited for too long; Zenoh connects again by itself."""
        self.admission.look_after()

    def close(self) -> None:
        """End the session."""
        self._zenoh.close()

    def _token(self, kind: str, channel: RosChannel) -> tuple[str, "zenoh.LivelinessToken"]:
        self._entities += 1
        token = endpoint_token(self._id, self.node, self._entities, kind, channel)
        return token, self._zenoh.liveliness().declare_token(token)

    def _declare(self, channel: RosChannel) -> _Publisher:
        import zenoh.ext  # noqa: PLC0415

        key = data_key(self.node.domain, channel)
        # As rmw_zenoh: a message is rather dropped than that its sender waits for a slow subscriber.
        drop = zenoh.CongestionControl.DROP
        if channel.quality.is_latched:
            cache = zenoh.ext.CacheConfig(channel.quality.depth)
            publisher: Any = zenoh.ext.declare_advanced_publisher(
                self._zenoh, key, congestion_control=drop, cache=cache, publisher_detection=True
            )
            large = publisher  # one cache has all messages
        else:
            publisher = self._zenoh.declare_publisher(key, congestion_control=drop)
            large = self._zenoh.declare_publisher(key, congestion_control=drop, express=True)
        token, declared = self._token(PUBLISHER, channel)
        number = gid(token)
        self._gids.add(number)
        return _Publisher(publisher, large, declared, number)

    # -- in threads of Zenoh ---------------------------------------------------------------------------

    def _on_token(self, sample: "zenoh.Sample") -> None:
        """Take what the token of an endpoint says of its node."""
        import zenoh  # noqa: PLC0415

        token = str(sample.key_expr)
        told = EndpointToken.decode(token)
        if told is None:
            return
        is_server = told.kind == SERVICE
        endpoint = _server(told.session, told.name) if is_server else gid(token)
        is_there = sample.kind == zenoh.SampleKind.PUT
        self.admission.tell(endpoint, {endpoint: told.node} if is_there else {})

    def _on_sample(self, channel: RosChannel, key: str, sample: "zenoh.Sample") -> None:
        arrived = str(sample.key_expr)
        if arrived != key:
            self.inbox.put_stranger(arrived)
            return
        attached = sample.attachment and Attachment.decode(sample.attachment.to_bytes())
        if attached and attached.gid in self._gids:
            self.withheld += 1
            return
        sender, sent_ns = (attached.gid, attached.sent_ns) if attached else (b"", 0)

        came_ns = time.monotonic_ns()

        def put() -> None:
            self.inbox.put(channel, sample.payload.to_bytes(), sent_ns, sender, came_ns)

        what, is_latched = f"a message on {channel.name}", channel.quality.is_latched
        self.admission.take(sender, what, len(sample.payload), put, is_latched)

    def _on_query(self, name: str, key: str, query: "zenoh.Query") -> None:
        attached = query.attachment and Attachment.decode(query.attachment.to_bytes())
        if not attached or query.payload is None:
            self.inbox.put_stranger(f"a request to {name} without attachment or content")
            return
        sequence, sent_ns, client = attached

        def answer(data: bytes) -> None:
            import zenoh  # noqa: PLC0415

            try:
                query.reply(key, data, attachment=Attachment(sequence, time.time_ns(), client).encode())
            except zenoh.ZError:
                self.unsent += 1
            query.drop()

        data = query.payload.to_bytes()
        put = partial(self.inbox.put_call, name, data, answer, sent_ns or None, time.monotonic_ns())
        self.admission.take(client, f"a request to {name}", len(data), put)


def _server(session: str, service: str) -> bytes:
    """Return by what the server of a service in a session of Zenoh is known: its responses do not name it."""
    return f"{session}{service}".encode()
