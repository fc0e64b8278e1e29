"""ROS 2 over DDS, as nodes with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp or rmw_fastrtps_cpp speak it.

CycloneDDS calls back in its own threads. They only put messages into the inbox.
"""

import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from robbie_mp.bridge.mapping import DEFAULT_DEPTH
from robbie_mp.messages import Message, from_dict
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.ros2.idl_types import raw_type, sample_of
from robbie_mp.ros2.side import Channel, Inbox, NodeName, Ros2Unavailable
from robbie_mp.ros2.type_hash import type_hash

if TYPE_CHECKING:
    from collections.abc import Callable

    from robbie_mp.ros2.service_types import ServiceType

LOOPBACK = "lo"
MAX_TAKEN = 256
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
"""What each participant tells of its nodes and their endpoints (rmw_dds_common)."""
_SETTINGS = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="{interface}"/></Interfaces>{multicast}</General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
{peers}</Discovery></Domain></CycloneDDS>"""


ENCAPSULATION_BYTES, HEADER_BYTES = 4, 16
"""Before each message; and, after that, before each request and response: the client and a number."""
LITTLE_ENDIAN = 1
RESPONSE_WAIT_NS = 1_000_000_000
"""How long a response waits until the client's reader has been discovered, which can be after its request."""
MAX_RESPONSES = 64
"""Most responses that wait for that."""


@dataclass
class _Response:
    """A response that waits for the client's reader."""

    writer: Any
    participant: Any
    data: bytes
    until_ns: int


@dataclass
class DdsSide:
    """The robot as a node in a domain of DDS.

    Args:
        node: the node's name.
        inbox: where messages go.
        types: returns the class of a type's messages.
        interface: the network interface to use; on `lo`, only nodes of this machine are found.

    Raises:
        Ros2Unavailable: a package is missing, or the interface.
    """

    node: NodeName
    inbox: Inbox
    types: "Callable[[str], type[Message]]"
    interface: str = LOOPBACK
    unsent: int = 0
    incompatible: int = 0
    """Endpoints of others that do not fit because of their quality of service."""
    _writers: dict[Channel, Any] = field(default_factory=dict)
    _readers: list[Any] = field(default_factory=list)
    _responders: list[Any] = field(default_factory=list)
    _responses: deque[_Response] = field(default_factory=deque)

    def __post_init__(self) -> None:
        try:
            from cyclonedds.core import DDSException, Policy, Qos  # noqa: PLC0415
            from cyclonedds.domain import Domain, DomainParticipant  # noqa: PLC0415
            from cyclonedds.topic import Topic  # noqa: PLC0415
        except ImportError as error:
            raise Ros2Unavailable(
                "the bridge to ROS 2 needs the extra `ros2`: run `pip install 'robbie-mp[ros2]'`"
            ) from error
        is_local = self.interface == LOOPBACK
        multicast = "<AllowMulticast>false</AllowMulticast>" if is_local else ""
        peers = '<Peers><Peer address="127.0.0.1"/></Peers>' if is_local else ""
        settings = _SETTINGS.format(interface=self.interface, multicast=multicast, peers=peers)
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
        self._nodes = self._writer(Topic(self._participant, DISCOVERY, self._told), True, True, 1, NODES)
        self._tell()

    def send(self, channel: Channel, data: bytes) -> None:
        """Send a message; the first on a channel announces a publisher."""
        from cyclonedds.core import DDSException  # noqa: PLC0415

        if channel not in self._writers:
            topic, message_type = self._topic(channel)
            quality = channel.quality
            self._writers[channel] = self._writer(
                topic, quality.is_reliable, quality.is_latched, quality.depth, message_type
            )
            self._tell()
        writer = self._writers[channel]
        try:
            writer.write(sample_of(writer.topic.data_type, data))
        except DDSException:
            self.unsent += 1

    def listen(self, channel: Channel) -> None:
        """Ask for the messages of a channel."""
        from cyclonedds.core import Listener  # noqa: PLC0415
        from cyclonedds.sub import DataReader  # noqa: PLC0415

        inbox = self.inbox

        class Taking(Listener):  # type: ignore[misc, unused-ignore]
            def on_data_available(self, reader: Any) -> None:
                for sample in reader.take(MAX_TAKEN):
                    if hasattr(sample, "raw"):
                        inbox.put(channel, sample.raw)

        topic, message_type = self._topic(channel)
        quality = channel.quality
        policies = self._quality(quality.is_reliable, quality.is_latched, quality.depth, message_type)
        self._readers.append(DataReader(self._participant, topic, policies, Taking()))
        self._tell()

    def serve(self, name: str, service: "ServiceType") -> None:
        """Offer a service: a topic for requests, and one for responses."""
        from cyclonedds.core import Listener  # noqa: PLC0415
        from cyclonedds.sub import DataReader  # noqa: PLC0415
        from cyclonedds.topic import Topic  # noqa: PLC0415

        side = self
        asked, answered = service.over_dds
        identity = f"serviceid={self._service_id()};".encode()
        requests = Topic(self._participant, f"rq{name}Request", raw_type(asked))
        responses = Topic(self._participant, f"rr{name}Reply", raw_type(answered))
        writer = self._writer(responses, True, False, DEFAULT_DEPTH, service.response, identity)

        class Taking(Listener):  # type: ignore[misc, unused-ignore]
            def on_data_available(self, reader: Any) -> None:
                for sample in reader.take(MAX_TAKEN):
                    if hasattr(sample, "raw"):
                        side._on_request(name, reader, writer, sample)

        policies = self._quality(True, False, DEFAULT_DEPTH, service.request, identity)
        self._responders.append(writer)
        self._readers.append(DataReader(self._participant, requests, policies, Taking()))
        self._tell()

    def look_after(self) -> None:
        """Send responses whose clients are known now, and count endpoints that do not fit."""
        for _ in range(len(self._responses)):
            response = self._responses.popleft()
            if not self._respond(response):
                self._responses.append(response)
        readers = sum(one.get_requested_incompatible_qos_status().total_count for one in self._readers)
        writers = self._writers.values()
        self.incompatible = readers + sum(
            one.get_offered_incompatible_qos_status().total_count for one in writers
        )

    def close(self) -> None:
        """Leave the domain."""
        self._participant._delete(self._participant._ref)
        self._domain._delete(self._domain._ref)

    def _topic(self, channel: Channel) -> tuple[Any, type[Message]]:
        from cyclonedds.topic import Topic  # noqa: PLC0415

        message_type = self.types(channel.type_name)
        return Topic(self._participant, f"rt{channel.name}", raw_type(message_type)), message_type

    def _service_id(self) -> str:
        """Return the identity of the next service: that of the participant, and a number."""
        number = len(self._responders) + 1
        identity = self._participant.guid.bytes[:12] + number.to_bytes(4, "big")
        return ".".join(f"{one:x}" for one in identity)

    def _answer(self, response: _Response) -> None:
        if len(self._responses) >= MAX_RESPONSES:
            self.unsent += 1
        elif not self._respond(response):
            self._responses.append(response)

    def _respond(self, response: _Response) -> bool:
        """Send a response if its client has a reader; return False if it must wait for that."""
        from cyclonedds.core import DDSException  # noqa: PLC0415

        writer = response.writer
        found = map(writer.get_matched_subscription_data, writer.get_matched_subscriptions())
        if not any(one is not None and one.participant_key == response.participant for one in found):
            is_over = time.monotonic_ns() >= response.until_ns
            self.unsent += is_over
            return is_over
        try:
            writer.write(sample_of(writer.topic.data_type, response.data))
        except DDSException:
            self.unsent += 1
        return True

    def _writer(
        self,
        topic: Any,
        is_reliable: bool,
        is_latched: bool,
        depth: int,
        message_type: type[Message],
        identity: bytes = b"",
    ) -> Any:
        from cyclonedds.pub import DataWriter  # noqa: PLC0415

        policies = self._quality(is_reliable, is_latched, depth, message_type, identity)
        return DataWriter(self._participant, topic, policies)

    def _quality(
        self,
        is_reliable: bool,
        is_latched: bool,
        depth: int,
        message_type: type[Message],
        identity: bytes = b"",
    ) -> Any:
        from cyclonedds.core import Policy, Qos  # noqa: PLC0415

        # 0: a write does not wait for slow readers.
        reliability = Policy.Reliability.Reliable(0) if is_reliable else Policy.Reliability.BestEffort
        durability = Policy.Durability.TransientLocal if is_latched else Policy.Durability.Volatile
        kept = Policy.History.KeepLast(depth)
        return Qos(
            reliability,
            durability,
            kept,
            Policy.DurabilityService(0, kept, -1, -1, -1),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.IgnoreLocal.Participant,
            Policy.Userdata(identity + f"typehash={type_hash(message_type)};".encode()),
        )

    def _tell(self) -> None:
        """Tell other participants of the node and its endpoints."""
        node = {
            "node_namespace": self.node.namespace,
            "node_name": self.node.name,
            "reader_gid_seq": [_gid(one) for one in self._readers],
            "writer_gid_seq": [_gid(one) for one in (*self._writers.values(), *self._responders)],
        }
        told = from_dict(NODES, {"gid": _gid(self._participant), "node_entities_info_seq": [node]})
        self._nodes.write(sample_of(self._told, told.encode()))

    # -- in threads of CycloneDDS ----------------------------------------------------------------------

    def _on_request(self, name: str, reader: Any, writer: Any, sample: Any) -> None:
        data: bytes = sample.raw
        begin = ENCAPSULATION_BYTES + HEADER_BYTES
        handle = sample.sample_info.publication_handle
        if len(data) <= begin or data[1] != LITTLE_ENDIAN:
            self.inbox.put_stranger(f"a request to {name} without its header, or not little endian")
            return
        header = data[ENCAPSULATION_BYTES:begin]

        def answer(response: bytes) -> None:
            client = reader.get_matched_publication_data(handle)
            if client is None:  # it has gone
                self.unsent += 1
                return
            whole = response[:ENCAPSULATION_BYTES] + header + response[ENCAPSULATION_BYTES:]
            until_ns = time.monotonic_ns() + RESPONSE_WAIT_NS
            self._answer(_Response(writer, client.participant_key, whole, until_ns))

        self.inbox.put_call(name, data[:ENCAPSULATION_BYTES] + data[begin:], answer)


def _gid(entity: Any) -> dict[str, Any]:
    return {"data": np.frombuffer(entity.guid.bytes, np.uint8)}
