"""What CycloneDDS's library cannot do for ROS 2 over DDS: services for its own and FastDDS's clients at once.

rmw_fastrtps puts the identity of a request into the parameters before the message, rmw_cyclonedds into 16
bytes before its fields: the client, and a number. CycloneDDS's library does not let a program see or write
those parameters, so services have a participant of their own here. It also reads the feedback of actions and
knows the publishers that CycloneDDS ignores.
"""

import struct
import time
from collections import deque
from collections.abc import Callable, Container
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from robbie_mp.connect.ros2.action_types import part
from robbie_mp.connect.ros2.nodes import Admission
from robbie_mp.connect.ros2.rtps import wire
from robbie_mp.connect.ros2.rtps.endpoints import ReliableReader, ReliableWriter
from robbie_mp.connect.ros2.rtps.participant import Participant, RemoteEndpoint
from robbie_mp.connect.ros2.side import RESPONSE_LIMIT_S, MiddlewareInbox, RosChannel
from robbie_mp.connect.ros2.type_hash import type_hash

if TYPE_CHECKING:
    from robbie_mp.connect.ros2.service_types import ServiceType

FEEDBACK: Final = part("", "feedback")
"""How the names of topics with feedback of actions end."""
CYCLONEDDS: Final = b"\x01\x10"
"""The number of its vendor, with which the GUIDs of its participants begin."""
ENCAPSULATION_BYTES, HEADER_BYTES = 4, 16
LITTLE_ENDIAN: Final = b"\x00\x01"
RESPONSE_WAIT_S: Final = 1.0
"""How long a response waits until the client's reader has been discovered, which can be after its request."""
Done = Callable[["bytes | str"], None]
"""Gets the encoded response of a call, or a text that says why there is none."""
SERVER_WAIT_S: Final = 1.0
"""How long a request waits until a node that serves it has been found."""
MAX_PARTS: Final = 2
"""Parts of messages that have not come whole take at most this many times the largest message."""
MAX_REQUESTS: Final = 64
MAX_RESPONSES: Final = 64
"""Most responses that wait for that."""


@dataclass
class _Response:
    """A response that waits for the client's reader."""

    writer: ReliableWriter
    payload: bytes
    parameters: bytes
    to: bytes
    until_s: float


class _Request(NamedTuple):
    """A request of this node that has no response yet."""

    data: bytes
    done: Done
    until_s: float
    limit_s: float
    """Time for the response, once it was sent."""
    server: bytes = b""
    """The participant that it was sent to."""


@dataclass
class _Client:
    """A service of ROS that this node calls."""

    name: str
    writer: ReliableWriter
    reader: ReliableReader
    group: str = ""
    """Clients with the same one ask a participant only if it serves them all."""
    waiting: "deque[_Request]" = field(default_factory=deque)
    sent: dict[int, _Request] = field(default_factory=dict)

    def servers(self) -> list[bytes]:
        """Return the participants that serve it and know this client, in the order of their discovery."""
        met = {one[: wire.PREFIX_BYTES] for one, proxy in self.reader.writers.items() if proxy.knows_reader}
        readers = (one[: wire.PREFIX_BYTES] for one in self.writer.readers)
        return [one for one in readers if one in met]


@dataclass
class DdsServices:
    """The services of a node, and those that it calls.

    Args:
        domain: the domain.
        interface: the network interface.
        inbox: where requests go.
        topics: the topics in DDS whose publishers `publishers` returns; may grow.
        admission: which nodes are served, called and heard.

    Raises:
        NoInterface: there is none of that name.

    Attributes:
        unsent: responses whose client had no reader for them.
        incompatible: endpoints of others that do not fit because of their quality of service.
    """

    domain: int
    interface: str
    inbox: MiddlewareInbox
    topics: Container[str]
    admission: Admission
    unsent: int = 0
    incompatible: int = 0
    readers: list[bytes] = field(default_factory=list)
    """GUIDs of the readers of requests; `writers`: those of the writers of responses."""
    writers: list[bytes] = field(default_factory=list)
    _waiting: "deque[_Response]" = field(default_factory=deque)
    _clients: dict[str, _Client] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._participant = Participant(
            self.domain, self.interface, self._is_wanted, self.admission, MAX_PARTS * self.inbox.max_bytes
        )
        self._participant.on_look = self._look_after
        self._participant.on_oversized = self.inbox.count_oversized
        self._participant.on_unfit = self._on_unfit
        self._participant.on_malformed = lambda: self.inbox.put_stranger("a datagram that is not of RTPS")

    @property
    def has_failed(self) -> bool:
        """Whether its thread has ended, which only a mistake in this program does."""
        return not self._participant.is_alive

    def serve(self, name: str, service: "ServiceType") -> None:
        """Offer a service: a topic for requests, and one for responses."""
        dds_type = _dds_type(service)
        identity = f"serviceid={self._service_id()};typehash="
        asked, answered = (
            f"{identity}{type_hash(one)};".encode() for one in (service.request, service.response)
        )
        writer = self._participant.add_writer(f"rr{name}Reply", f"{dds_type}_Response_", answered)

        def take(sample: wire.Sample) -> None:
            self._on_request(name, writer, sample)

        reader = self._participant.add_reader(
            f"rq{name}Request", f"{dds_type}_Request_", asked, take, self.inbox.max_bytes
        )
        self.readers.append(self._participant.guid(reader))
        self.writers.append(self._participant.guid(writer))

    def join(self, name: str, service: "ServiceType", group: str = "") -> None:
        """Prepare to call a service of ROS; see `Side.join`."""
        dds_type = _dds_type(service)
        asked, answered = (
            f"typehash={type_hash(one)};".encode() for one in (service.request, service.response)
        )
        with self._participant.lock:
            writer = self._participant.add_writer(f"rq{name}Request", f"{dds_type}_Request_", asked)
            reader = self._participant.add_reader(
                f"rr{name}Reply",
                f"{dds_type}_Response_",
                answered,
                lambda sample: self._on_response(name, sample),
                self.inbox.max_bytes,
            )
            self._clients[name] = _Client(name, writer, reader, group)
        self.readers.append(self._participant.guid(reader))
        self.writers.append(self._participant.guid(writer))

    def hear(self, channel: RosChannel) -> None:
        """Ask for the messages of a channel."""
        told = f"typehash={channel.type_hash};".encode()

        def take(sample: wire.Sample) -> None:
            self.inbox.put(channel, sample.payload, sample.sent_ns or time.time_ns())

        reader = self._participant.add_reader(
            f"rt{channel.name}", channel.dds_type, told, take, self.inbox.max_bytes
        )
        self.readers.append(self._participant.guid(reader))

    def publishers(self) -> list[RemoteEndpoint]:
        """Return the publishers of other participants on `topics`."""
        with self._participant.lock:
            others = list(self._participant.others.values())
        return [one for one in others if one.topic in self.topics and one.is_writer]

    def call(self, name: str, data: bytes, done: Done, limit_s: float = RESPONSE_LIMIT_S) -> None:
        """Call a service of ROS, as soon as a node that serves it is found.

        Args:
            name: its name; `join` has prepared it.
            data: the encoded request.
            done: called once, in any thread, with the response, or with a text that says what is wrong.
            limit_s: time for the response, s.
        """
        client = self._clients[name]
        with self._participant.lock:
            if len(client.waiting) + len(client.sent) >= MAX_REQUESTS:
                done(f"{MAX_REQUESTS} requests to {name} have no response yet")
                return
            client.waiting.append(_Request(data, done, time.monotonic() + SERVER_WAIT_S, limit_s))
            self._send_requests(client)

    def close(self) -> None:
        """Leave the domain."""
        self._participant.close()

    def _is_wanted(self, topic: str) -> bool:
        return topic.startswith(("rq/", "rr/")) or topic.endswith(FEEDBACK) or topic in self.topics

    def _service_id(self) -> str:
        """Return the identity of the next service, with which clients of CycloneDDS tell services apart."""
        identity = self._participant.prefix + (len(self.readers) + 1).to_bytes(4, "big")
        return ".".join(f"{one:x}" for one in identity)

    # -- in the participant's thread ---------------------------------------------------------------------

    def _on_unfit(self, other: RemoteEndpoint, has_type: bool) -> None:
        """Count an endpoint that does not fit; those on topics are compared by `DdsSide`."""
        if has_type:
            self.incompatible += 1
        elif other.topic.startswith(("rq/", "rr/")):
            self.inbox.put_stranger(f"{other.topic[2:]} has the type {other.type_name}")

    def _on_request(self, name: str, writer: ReliableWriter, sample: wire.Sample) -> None:
        data, to = sample.payload, sample.writer[: wire.PREFIX_BYTES]
        has_header = to.startswith(CYCLONEDDS)
        begin = ENCAPSULATION_BYTES + (HEADER_BYTES if has_header else 0)
        if len(data) < begin or data[:2] != LITTLE_ENDIAN:
            self.inbox.put_stranger(f"a request to {name} without its header, or not little endian")
            return
        header = data[ENCAPSULATION_BYTES:begin]
        parameters = b"" if has_header else _related_to(sample)

        def answer(response: bytes) -> None:
            payload = response[:ENCAPSULATION_BYTES] + header + response[ENCAPSULATION_BYTES:]
            until_s = time.monotonic() + RESPONSE_WAIT_S
            self._answer(_Response(writer, payload, parameters, to, until_s))

        whole = data[:ENCAPSULATION_BYTES] + data[begin:]
        self.inbox.put_call(name, whole, answer, sample.sent_ns)

    def _on_response(self, name: str, sample: wire.Sample) -> None:
        client, data = self._clients[name], sample.payload
        begin = ENCAPSULATION_BYTES
        if sample.writer.startswith(CYCLONEDDS):
            begin += HEADER_BYTES
            if len(data) < begin or data[ENCAPSULATION_BYTES : begin - 8] != self._client_id(client):
                return
            (number,) = struct.unpack_from("<q", data, begin - 8)
        else:
            named = wire.identity_of(sample.parameters)
            own = (self._participant.guid(client.reader), self._participant.guid(client.writer))
            if named is None or named[0] not in own:
                return
            number = named[1]
        request = client.sent.pop(number, None)
        if request is not None:
            request.done(data[:ENCAPSULATION_BYTES] + data[begin:])

    def _look_after(self) -> None:
        with self._participant.lock:
            for client in self._clients.values():
                self._send_requests(client)
                self._end_requests(client)
            self._send_waiting()

    def _server(self, client: _Client) -> bytes:
        """Return the newest participant that serves a client and its group; empty if there is none.

        That of a node that was killed stays known for a while, beside that of the node which replaces it.
        """
        group = [one for one in self._clients.values() if client.group and one.group == client.group]
        others = [set(one.servers()) for one in group if one is not client]
        return next((one for one in reversed(client.servers()) if all(one in other for other in others)), b"")

    def _send_requests(self, client: _Client) -> None:
        server = self._server(client) if client.waiting else b""
        while server and client.waiting:
            request = client.waiting.popleft()
            request = request._replace(server=server, until_s=time.monotonic() + request.limit_s)
            data, number = request.data, client.writer.next
            client.sent[number] = request
            if server.startswith(CYCLONEDDS):
                header = self._client_id(client) + struct.pack("<q", number)
                data = data[:ENCAPSULATION_BYTES] + header + data[ENCAPSULATION_BYTES:]
                client.writer.write(data, to=server)
            else:
                client.writer.write(data, wire.related(self._participant.guid(client.reader), 0), server)

    def _end_requests(self, client: _Client) -> None:
        """Report requests that get no response any more."""
        now_s = time.monotonic()
        while client.waiting and client.waiting[0].until_s <= now_s:
            client.waiting.popleft().done(f"no node serves {client.name}")
        servers = {one[: wire.PREFIX_BYTES] for one in client.writer.readers}
        for number, request in list(client.sent.items()):
            if request.server not in servers:
                del client.sent[number]
                request.done(f"the node that serves {client.name} has gone")
            elif request.until_s <= now_s:
                del client.sent[number]
                request.done(f"the node that serves {client.name} has not answered in {request.limit_s:g} s")

    def _client_id(self, client: _Client) -> bytes:
        """Return the eight bytes by which CycloneDDS's servers know a client."""
        return self._participant.prefix[2:7] + client.writer.entity[:3]

    def _send_waiting(self) -> None:
        with self._participant.lock:
            for _ in range(len(self._waiting)):
                response = self._waiting.popleft()
                if not self._respond(response):
                    self._waiting.append(response)

    # -- in any thread -----------------------------------------------------------------------------------

    def _answer(self, response: _Response) -> None:
        with self._participant.lock:
            if len(self._waiting) >= MAX_RESPONSES:
                self.unsent += 1
            elif not self._respond(response):
                self._waiting.append(response)

    def _respond(self, response: _Response) -> bool:
        """Send a response if its client has a reader; return False if it must wait for that."""
        if not any(one.startswith(response.to) for one in response.writer.readers):
            is_over = time.monotonic() >= response.until_s
            self.unsent += is_over
            return is_over
        response.writer.write(response.payload, response.parameters, response.to)
        return True


def _dds_type(service: "ServiceType") -> str:
    """Return the beginning of the names of its types in DDS."""
    package, kind, name = service.name.split("/")
    return f"{package}::{kind}::dds_::{name}"


def _related_to(sample: wire.Sample) -> bytes:
    """Return the parameters of a response: the client's reader, or its writer, and the request's number."""
    named = wire.identity_of(sample.parameters)
    guid = named[0] if named is not None and named[0].strip(b"\0") else sample.writer
    return wire.related(guid, sample.sequence)
