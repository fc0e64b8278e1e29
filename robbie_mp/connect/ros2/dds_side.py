"""ROS 2 over DDS, as nodes with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp or rmw_fastrtps_cpp speak it.

CycloneDDS calls back in its own threads. They only put messages into the inbox.

CycloneDDS 11.0 may ignore publishers of nodes with FastDDS 3 (Kilted): it reads the type descriptions that
such nodes exchange, marks some of them as invalid, and reports nothing. So feedback of actions is read
without it, and the bridge names other publishers that CycloneDDS ignores.
"""

import re
import time
from collections import OrderedDict
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robbie_mp.base.extras import how_to_install
from robbie_mp.base.linux.address_space import own_memory_bytes
from robbie_mp.connect.ros2.idl_types import raw_type, sample_of, topic_of
from robbie_mp.connect.ros2.nodes import Admission
from robbie_mp.connect.ros2.rtps import wire
from robbie_mp.connect.ros2.rtps.participant import NoInterface, RemoteEndpoint
from robbie_mp.connect.ros2.rtps.services import FEEDBACK, DdsServices
from robbie_mp.connect.ros2.side import (
    RESPONSE_LIMIT_S,
    MiddlewareInbox,
    NodeName,
    Ros2Unavailable,
    RosChannel,
)
from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.messages import Message, MessageError, from_dict
from robbie_mp.messages.schema_parser import message_type_from_schema

if TYPE_CHECKING:
    from collections.abc import Callable

    from robbie_mp.connect.ros2.service_types import ServiceType

LOOPBACK = "lo"
MAX_TAKEN = 256
MAX_TOLD_BYTES = 1 << 18
"""A participant that tells more of its nodes is not believed; 16,000 endpoints take as much."""
DISCOVERY = "ros_discovery_info"
NODES = message_type_from_schema(
    "rmw_dds_common/msg/ParticipantEntitiesInfo",
    """Gid gid
NodeEntitiesInfo[] node_entities_info_seq
================================================================================
MSG: rmw_dds_common/Gid
uint8[16] data
================================================================================
MSG: rmw_dds_common/NodeEntitiesInfo
string<=256 node_namespace
string<=256 node_name
Gid[] reader_gid_seq
Gid[] writer_gid_seq
""",
)
"""The topic on which each participant tells of its nodes and their endpoints (rmw_dds_common)."""
_LARGE = "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize>"
"""Within a machine, datagrams need not fit into packets of a network."""
_SETTINGS = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="{interface}"/></Interfaces>{multicast}</General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
{peers}</Discovery></Domain></CycloneDDS>"""


PADDED_TO = 4
MAX_KEPT, KEPT_BYTES = 8, 48 << 20
"""Most messages that a reliable publisher keeps until its readers have them, and most bytes of these."""
HANDLES = 1 << 64
LOOK_NS = 1_000_000_000
"""Time between two looks at the types of others' endpoints."""
MAX_ENDPOINTS = 1000
MAX_LOOKED_AT = 16
"""Most new endpoints of each kind that are read at once."""
FORGOTTEN_AFTER_LOOKS = 400
"""A publisher that has gone is forgotten after more looks than a lease can last: then it is not just late."""
IGNORED_AFTER_LOOKS = 5
"""A publisher counts as ignored by CycloneDDS once it has been missing there at this many looks in a row."""
REFUSAL = "CycloneDDS ignores a publisher of {}; restart this module (see docs/ros2.md)"
HASH = re.compile(rb"typehash=(RIHS01_[0-9a-f]{64});")


def settings_of_domain(interface: str) -> str:
    """Return the settings of CycloneDDS for a network interface.

    Args:
        interface: the interface; on `lo`, only nodes of this machine are found.
    """
    is_local = interface == LOOPBACK
    multicast = f"<AllowMulticast>false</AllowMulticast>{_LARGE}" if is_local else ""
    peers = '<Peers><Peer address="127.0.0.1"/></Peers>' if is_local else ""
    return _SETTINGS.format(interface=interface, multicast=multicast, peers=peers)


def kept_for(size: int) -> int:
    """Return how many messages of a size, in bytes, a reliable publisher keeps until its readers have them.

    If a reader misses parts of a message that is not kept any more, CycloneDDS tells it so in a GAP. Then
    FastDDS (2.14, 3.2) does not forget the parts that it has, and reads them for ever. With a single message
    kept, that may befall a node which is late for one image.
    """
    return max(1, min(MAX_KEPT, KEPT_BYTES // max(1, size)))


class _Endpoint(NamedTuple):
    """What an endpoint of another participant says of its topic."""

    is_writer: bool
    topic: str
    type_name: str
    hashes: list[bytes]


@dataclass
class DdsSide:
    """The robot as a node in a domain of DDS.

    Args:
        node: the node's name.
        inbox: where messages go.
        types: returns the class of a channel's messages.
        interface: the network interface to use; on `lo`, only nodes of this machine are found.
        admission: which nodes it deals with; CycloneDDS cannot keep others from reading what it sends.
        max_memory_bytes: memory that the process may take after this was made; beyond it, `look_after` fails.

    Raises:
        Ros2Unavailable: a package is missing, or the interface.
    """

    node: NodeName
    inbox: MiddlewareInbox
    types: "Callable[[RosChannel], type[Message]]"
    interface: str = LOOPBACK
    admission: Admission = field(default_factory=lambda: Admission(["*"], 0))
    max_memory_bytes: int = 1 << 30
    incompatible: int = 0
    """Endpoints of others that do not fit because of their quality of service."""
    refusal: str = ""
    """Which publishers CycloneDDS ignores, and what to do; '' if there are none."""
    _writers: dict[RosChannel, Any] = field(default_factory=dict)
    _readers: list[Any] = field(default_factory=list)
    _services: DdsServices | None = None
    _untaken: int = 0
    """Messages that CycloneDDS did not take."""
    _asked: dict[str, RosChannel] = field(default_factory=dict)
    """Channels by their topic in DDS: those that this node reads; `_offered` has those that it writes."""
    _heard: dict[str, RosChannel] = field(default_factory=dict)
    """Those that come by way of `_services`."""
    _offered: dict[str, RosChannel] = field(default_factory=dict)
    _named: set[bytes] = field(default_factory=set)
    """Endpoints of other types that have been counted."""
    _others: "OrderedDict[bytes, _Endpoint]" = field(default_factory=OrderedDict)
    """What endpoints of others say, by their GUIDs; the oldest go first."""
    _channels: int = 0
    """Number of channels with which they were compared."""
    _seen: dict[bytes, int] = field(default_factory=dict)
    """Publishers that CycloneDDS has found on the topics of `_asked`, with the looks since they have gone."""
    _looked_ns: int = 0
    _unknown: dict[bytes, int] = field(default_factory=dict)
    """Publishers that CycloneDDS does not know, with the number of looks."""

    def __post_init__(self) -> None:
        self._memory_at_first_bytes = own_memory_bytes()
        try:
            from cyclonedds.builtin import (  # noqa: PLC0415
                BuiltinDataReader,
                BuiltinTopicDcpsPublication,
                BuiltinTopicDcpsSubscription,
            )
            from cyclonedds.core import (  # noqa: PLC0415
                DDSException,
                InstanceState,
                Policy,
                Qos,
                ReadCondition,
                SampleState,
                ViewState,
            )
            from cyclonedds.domain import Domain, DomainParticipant  # noqa: PLC0415
        except ImportError as error:
            raise Ros2Unavailable(
                f"the bridge to ROS 2 needs the extra `ros2`: {how_to_install('ros2')}"
            ) from error
        settings = settings_of_domain(self.interface)
        try:
            self._domain = Domain(self.node.domain, settings)
            self._participant = DomainParticipant(
                self.node.domain, Qos(Policy.EntityName(self.node.name), Policy.Userdata(b"enclave=/;"))
            )
        except DDSException as error:
            raise Ros2Unavailable(
                f"CycloneDDS cannot use the interface {self.interface!r}: {error}"
            ) from error
        self._told = raw_type(NODES)
        self._endpoints = (
            BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication),
            BuiltinDataReader(self._participant, BuiltinTopicDcpsSubscription),
        )
        new = ViewState.Any | SampleState.NotRead | InstanceState.Alive
        self._new = tuple(ReadCondition(one, new) for one in self._endpoints)
        self._tellers: dict[int, bytes] = {}
        """Participants that have told of nodes which match, by the number of their publisher."""
        self._senders: dict[int, bytes] = {}
        """GUIDs of publishers, by the number that CycloneDDS gives them."""
        told = topic_of(self._participant, DISCOVERY, self._told)
        self._nodes = self._writer(told, True, True, 1, NODES)
        self._tell()
        self._names = None if self.admission.is_open else self._listen_to_names(told)

    def _listen_to_names(self, topic: Any) -> Any:
        """Return a reader of what participants tell of their nodes."""
        from cyclonedds.core import Policy, Qos  # noqa: PLC0415

        policies = Qos(
            Policy.Reliability.Reliable(0),
            Policy.Durability.TransientLocal,
            Policy.History.KeepAll,
            Policy.IgnoreLocal.Participant,
            Policy.Userdata(f"typehash={type_hash(NODES)};".encode()),
        )
        return self._reader(topic, policies, self._on_names)

    def _on_names(self, reader: Any, handle: int, data: bytes, _sent_ns: int) -> None:
        """Take what a participant tells of its own nodes; in a thread of CycloneDDS."""
        try:
            told: Any = NODES.decode(data) if len(data) <= MAX_TOLD_BYTES else None
        except MessageError:
            told = None
        own = self._sender(reader, handle)[: wire.PREFIX_BYTES]
        if told is None or bytes(told.gid.data)[: wire.PREFIX_BYTES] != own:
            self.inbox.put_stranger("what a participant tells of its nodes is wrong")
            return
        nodes: dict[bytes, str] = {}
        for one in told.node_entities_info_seq:
            name = f"{one.node_namespace.rstrip('/')}/{one.node_name}"
            nodes |= {bytes(gid.data): name for gid in (*one.reader_gid_seq, *one.writer_gid_seq)}
        if self.admission.tell(own, nodes):
            self._tellers[handle] = own

    def _reader(self, topic: Any, policies: Any, take: "Callable[[Any, int, bytes, int], None]") -> Any:
        """Return a reader.

        Args:
            topic: its topic.
            policies: its quality of service.
            take: gets the reader, the number of the publisher, each message, and when it was sent, in ns
                since 1970; in another thread.
        """
        from cyclonedds.core import Listener  # noqa: PLC0415
        from cyclonedds.sub import DataReader  # noqa: PLC0415

        class Taking(Listener):  # type: ignore[misc, unused-ignore]
            def on_data_available(self, reader: Any) -> None:
                for sample in reader.take(MAX_TAKEN):
                    if hasattr(sample, "raw"):
                        about = sample.sample_info
                        take(reader, about.publication_handle, sample.raw, about.source_timestamp)

        return DataReader(self._participant, topic, policies, Taking())

    def _sender(self, reader: Any, handle: int) -> bytes:
        """Return the GUID of a publisher; empty if it has gone."""
        found = self._senders.get(handle)
        if found is None:
            told = reader.get_matched_publication_data(handle)
            found = told.key.bytes if told is not None else b""
            if found:
                if len(self._senders) >= MAX_ENDPOINTS:
                    self._senders.clear()
                self._senders[handle] = found
        return found

    @property
    def unsent(self) -> int:
        """Messages that the middleware did not take."""
        return self._untaken + (self._services.unsent if self._services is not None else 0)

    def send(self, channel: RosChannel, data: memoryview | bytes) -> None:
        """Send a message; the first on a channel announces a publisher."""
        self.announce(channel, len(data))
        self._write(self._writers[channel], data)

    def announce(self, channel: RosChannel, size: int = 0) -> None:
        """Announce a publisher before it has anything to send; `size`: that of its messages, in bytes."""
        if channel not in self._writers:
            topic, message_type = self._topic(channel)
            self._offered[f"rt{channel.name}"] = channel
            quality = channel.quality
            self._writers[channel] = self._writer(
                topic, quality.is_reliable, quality.is_latched, quality.depth, message_type, kept_for(size)
            )
            self._tell()

    def listen(self, channel: RosChannel) -> None:
        """Ask for the messages of a channel."""
        if channel.name.endswith(FEEDBACK):
            self._with_services().hear(channel)
            self._heard[f"rt{channel.name}"] = channel
            self._tell()
            return

        def take(reader: Any, handle: int, data: bytes, sent_ns: int) -> None:
            is_asked = not self.admission.is_open or channel in self.inbox.taps
            sender = self._sender(reader, handle) if is_asked else b""
            put = partial(self.inbox.put, channel, data, sent_ns, sender, time.monotonic_ns())
            what, is_latched = f"a message on {channel.name}", channel.quality.is_latched
            self.admission.take(sender, what, len(data), put, is_latched)

        topic, message_type = self._topic(channel)
        self._asked[f"rt{channel.name}"] = channel
        quality = channel.quality
        policies = self._quality(quality.is_reliable, quality.is_latched, quality.depth, message_type)
        self._readers.append(self._reader(topic, policies, take))
        self._tell()

    def serve(self, name: str, service: "ServiceType") -> None:
        """Offer a service."""
        self._with_services().serve(name, service)
        self._tell()

    def join(self, name: str, service: "ServiceType", group: str = "") -> None:
        """Prepare to call a service of ROS."""
        self._with_services().join(name, service, group)
        self._tell()

    def call(
        self,
        name: str,
        data: bytes,
        done: "Callable[[bytes | str], None]",
        limit_s: float = RESPONSE_LIMIT_S,
    ) -> None:
        """Call a service of ROS."""
        self._with_services().call(name, data, done, limit_s)

    def look_after(self) -> None:
        """Count endpoints that do not fit.

        Raises:
            Ros2Unavailable: what serves requests has failed, or the process has too much memory.
        """
        if self._services is not None and self._services.has_failed:
            raise Ros2Unavailable("the thread that serves requests has ended; the trace has its error")
        self.admission.look_after()
        is_complete = self._read_endpoints()
        if time.monotonic_ns() - self._looked_ns >= LOOK_NS:
            self._looked_ns = time.monotonic_ns()
            self._look_at_memory()
            self._forget_names()
            publishers = self._services.publishers() if self._services is not None else []
            self._forget_seen({one.guid for one in publishers})
            # Before all new ones were read, one that CycloneDDS knows may be missing.
            is_complete = is_complete and len(self._seen) < MAX_ENDPOINTS
            ignored = self._ignored(publishers) if is_complete else []
            self.refusal = REFUSAL.format(", ".join(ignored)) if ignored else ""
        readers = sum(one.get_requested_incompatible_qos_status().total_count for one in self._readers)
        writers = self._writers.values()
        self.incompatible = readers + sum(
            one.get_offered_incompatible_qos_status().total_count for one in writers
        )
        self.incompatible += self._services.incompatible if self._services is not None else 0

    def _read_endpoints(self) -> bool:
        """Read some of the endpoints that CycloneDDS has found since, and return whether these were all.

        Reading one takes a millisecond, so a node that announces very many must not keep the module from its
        work.
        """
        from cyclonedds.core import Policy  # noqa: PLC0415

        counts = []
        for is_writer, reader, new in zip((True, False), self._endpoints, self._new, strict=True):
            found = reader.read(MAX_LOOKED_AT, new)
            counts.append(len(found))
            for one in found:
                if one.participant_key == self._participant.guid:
                    continue
                told = one.qos[Policy.Userdata].data if Policy.Userdata in one.qos else b""
                endpoint = _Endpoint(is_writer, one.topic_name, one.type_name, HASH.findall(told))
                self._others[one.key.bytes] = endpoint
                self._compare(one.key.bytes, endpoint)
                if is_writer and one.topic_name in self._asked and len(self._seen) < MAX_ENDPOINTS:
                    self._seen[one.key.bytes] = 0
                if len(self._others) > MAX_ENDPOINTS:
                    self._others.popitem(last=False)
        channels = len(self._asked) + len(self._heard) + len(self._offered)
        if channels != self._channels:
            self._channels = channels
            for key, endpoint in self._others.items():
                self._compare(key, endpoint)
        return max(counts) < MAX_LOOKED_AT

    def _look_at_memory(self) -> None:
        """Fail if nodes have announced so much that it fills the memory: the next process has none of it."""
        grown_bytes = own_memory_bytes() - self._memory_at_first_bytes
        if grown_bytes > self.max_memory_bytes:
            raise Ros2Unavailable(
                f"the bridge has taken {grown_bytes >> 20} MiB, more than `max_memory_bytes`: nodes have "
                f"announced very many endpoints, or messages wait for nodes that are late"
            )

    def _forget_names(self) -> None:
        """Forget what participants that have gone have told of their nodes."""
        if self._names is None:
            return
        tellers = list(self._tellers)  # before the look: one that comes meanwhile is alive
        # CycloneDDS's Python gives the numbers of publishers signed here, and unsigned with each message.
        alive = {one % HANDLES for one in self._names.get_matched_publications()}
        for handle in [one for one in tellers if one not in alive]:
            self.admission.forget(self._tellers.pop(handle))

    def _compare(self, key: bytes, endpoint: _Endpoint) -> None:
        """Count an endpoint of others whose topic has another type here; DDS keeps those apart."""
        topic = endpoint.topic
        asked = self._asked.get(topic) or self._heard.get(topic)
        channel = asked if endpoint.is_writer else self._offered.get(topic)
        if channel is None:
            return
        is_same = endpoint.type_name == channel.dds_type and channel.type_hash.encode() in (
            endpoint.hashes or [channel.type_hash.encode()]
        )
        if not is_same and key not in self._named and len(self._named) < MAX_ENDPOINTS:
            self._named.add(key)
            shown = b" ".join(endpoint.hashes).decode(errors="replace")
            self.inbox.put_stranger(f"{channel.name} has the type {endpoint.type_name} {shown}".rstrip())

    def _forget_seen(self, there: set[bytes]) -> None:
        """Forget publishers that have gone a while ago."""
        looks = {key: 0 if key in there else count + 1 for key, count in self._seen.items()}
        self._seen = {key: count for key, count in looks.items() if count < FORGOTTEN_AFTER_LOOKS}

    def _ignored(self, publishers: list[RemoteEndpoint]) -> list[str]:
        """Return the topics that have publishers which CycloneDDS ignores, of these publishers."""
        missing = [
            one
            for one in publishers
            if one.guid not in self._seen and one.type_name == self._asked[one.topic].dds_type
        ]
        self._unknown = {one.guid: self._unknown.get(one.guid, 0) + 1 for one in missing}
        return sorted(
            {self._asked[one.topic].name for one in missing if self._unknown[one.guid] >= IGNORED_AFTER_LOOKS}
        )

    def close(self) -> None:
        """Leave the domain."""
        if self._services is not None:
            self._services.close()
        self._participant._delete(self._participant._ref)
        self._domain._delete(self._domain._ref)

    def _topic(self, channel: RosChannel) -> tuple[Any, type[Message]]:
        message_type = self.types(channel)
        return topic_of(self._participant, f"rt{channel.name}", raw_type(message_type)), message_type

    def _with_services(self) -> DdsServices:
        if self._services is None:
            try:
                self._services = DdsServices(
                    self.node.domain, self.interface, self.inbox, self._asked, self.admission
                )
            except NoInterface as error:
                raise Ros2Unavailable(f"services cannot use the interface: {error}") from error
        return self._services

    def _write(self, writer: Any, data: memoryview | bytes) -> None:
        """Write a message from where it is: `DataWriter.write` would take no view, and copy more."""
        from cyclonedds.pub import ddspy_write  # noqa: PLC0415

        beyond = len(data) % PADDED_TO
        padded = data if not beyond else bytes(data).ljust(len(data) - beyond + PADDED_TO, b"\0")
        self._untaken += ddspy_write(writer._ref, padded) < 0

    def _writer(
        self,
        topic: Any,
        is_reliable: bool,
        is_latched: bool,
        depth: int,
        message_type: type[Message],
        kept: int = 1,
    ) -> Any:
        from cyclonedds.pub import DataWriter  # noqa: PLC0415

        policies = self._quality(is_reliable, is_latched, depth, message_type, kept)
        return DataWriter(self._participant, topic, policies)

    def _quality(
        self,
        is_reliable: bool,
        is_latched: bool,
        depth: int,
        message_type: type[Message],
        kept: int = 1,
    ) -> Any:
        from cyclonedds.core import Policy, Qos  # noqa: PLC0415

        # 0: a write does not wait for slow readers.
        reliability = Policy.Reliability.Reliable(0) if is_reliable else Policy.Reliability.BestEffort
        durability = Policy.Durability.TransientLocal if is_latched else Policy.Durability.Volatile
        return Qos(
            reliability,
            durability,
            Policy.History.KeepLast(max(depth, kept if is_reliable else 1)),
            Policy.DurabilityService(0, Policy.History.KeepLast(depth), -1, -1, -1),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.IgnoreLocal.Participant,
            Policy.Userdata(f"typehash={type_hash(message_type)};".encode()),
        )

    def _tell(self) -> None:
        """Tell other participants of the node and its endpoints."""
        readers = [one.guid.bytes for one in self._readers]
        writers = [one.guid.bytes for one in self._writers.values()]
        if self._services is not None:
            readers, writers = readers + self._services.readers, writers + self._services.writers
        node = {
            "node_namespace": self.node.namespace,
            "node_name": self.node.name,
            "reader_gid_seq": [_gid(one) for one in readers],
            "writer_gid_seq": [_gid(one) for one in writers],
        }
        participant = _gid(self._participant.guid.bytes)
        told = from_dict(NODES, {"gid": participant, "node_entities_info_seq": [node]})
        self._nodes.write(sample_of(self._told, told.encode()))


def _gid(guid: bytes) -> dict[str, Any]:
    return {"data": np.frombuffer(guid, np.uint8)}
