"""Services of ROS 2 over DDS, for clients with FastDDS and with CycloneDDS at once.

rmw_fastrtps puts the identity of a request into the parameters before the message, rmw_cyclonedds into 16
bytes before its fields: the client, and a number. CycloneDDS's library does not let a program see or write
those parameters, so services have a participant of their own here.
"""

import time
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from robbie_mp.connect.ros2.rtps import wire
from robbie_mp.connect.ros2.rtps.endpoints import Writer
from robbie_mp.connect.ros2.rtps.participant import Participant
from robbie_mp.connect.ros2.side import MiddlewareInbox
from robbie_mp.connect.ros2.type_hash import type_hash

if TYPE_CHECKING:
    from robbie_mp.connect.ros2.service_types import ServiceType

CYCLONEDDS: Final = b"\x01\x10"
"""The number of its vendor, with which the GUIDs of its participants begin."""
ENCAPSULATION_BYTES, HEADER_BYTES = 4, 16
LITTLE_ENDIAN: Final = b"\x00\x01"
RESPONSE_WAIT_S: Final = 1.0
"""How long a response waits until the client's reader has been discovered, which can be after its request."""
MAX_RESPONSES: Final = 64
"""Most responses that wait for that."""


@dataclass
class _Response:
    """A response that waits for the client's reader."""

    writer: Writer
    payload: bytes
    parameters: bytes
    to: bytes
    until_s: float


@dataclass
class DdsServices:
    """The services of a node.

    Args:
        domain: the domain.
        interface: the network interface.
        inbox: where requests go.

    Raises:
        NoInterface: there is none of that name.

    Attributes:
        unsent: responses whose client had no reader for them.
    """

    domain: int
    interface: str
    inbox: MiddlewareInbox
    unsent: int = 0
    readers: list[bytes] = field(default_factory=list)
    """GUIDs of the readers of requests; `writers`: those of the writers of responses."""
    writers: list[bytes] = field(default_factory=list)
    _waiting: "deque[_Response]" = field(default_factory=deque)

    def __post_init__(self) -> None:
        self._participant = Participant(self.domain, self.interface, _is_of_a_service)
        self._participant.on_look = self._send_waiting
        self._participant.on_malformed = lambda: self.inbox.put_stranger("a datagram that is not of RTPS")

    @property
    def has_failed(self) -> bool:
        """Whether its thread has ended, which only a mistake in this program does."""
        return not self._participant.is_alive

    def serve(self, name: str, service: "ServiceType") -> None:
        """Offer a service: a topic for requests, and one for responses."""
        dds_type = service.name.replace("/", "::").replace("::srv::", "::srv::dds_::")
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

    def close(self) -> None:
        """Leave the domain."""
        self._participant.close()

    def _service_id(self) -> str:
        """Return the identity of the next service, with which clients of CycloneDDS tell services apart."""
        identity = self._participant.prefix + (len(self.readers) + 1).to_bytes(4, "big")
        return ".".join(f"{one:x}" for one in identity)

    # -- in the participant's thread ---------------------------------------------------------------------

    def _on_request(self, name: str, writer: Writer, sample: wire.Sample) -> None:
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

        self.inbox.put_call(name, data[:ENCAPSULATION_BYTES] + data[begin:], answer)

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


def _is_of_a_service(topic: str) -> bool:
    return topic.startswith(("rq/", "rr/"))


def _related_to(sample: wire.Sample) -> bytes:
    """Return the parameters of a response: the client's reader, or its writer, and the request's number."""
    named = wire.identity_of(sample.parameters)
    guid = named[0] if named is not None and named[0].strip(b"\0") else sample.writer
    return wire.related(guid, sample.sequence)
