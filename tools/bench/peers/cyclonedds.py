"""Eclipse Cyclone DDS over the loopback interface, with IDL types."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from tools.bench.peers.peer import Peer, Send
from tools.bench.record import OnMessage
from tools.bench.work import Work

CONFIGURATION = """<CycloneDDS><Domain><General>
<Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces>
<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize></General>
<Internal><SocketReceiveBufferSize max="10MB"/></Internal></Domain></CycloneDDS>"""
"""Large datagrams and buffers, as the guide of Cyclone DDS recommends for large messages."""


class CycloneDDS(Peer):
    """Reliable, and keeps all waiting samples."""

    title = "Cyclone DDS"
    package = "cyclonedds"
    module = "cyclonedds"
    how = "IdlStruct, reliable, keep all, loopback interface; WaitSet blocks"

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Write samples."""
        from cyclonedds.pub import DataWriter  # noqa: PLC0415

        participant, topic, quality = _topic(work)
        message_type = topic.data_type
        writer = DataWriter(participant, topic, qos=quality)
        data = b"1" * work.size_bytes

        def send(number: int) -> None:
            writer.write(message_type(number, time.monotonic_ns(), 1.0, 2.0, 3.0, 4.0, 5.0, 6.0))

        def send_array(number: int) -> None:
            writer.write(message_type(number, time.monotonic_ns(), data))

        yield send_array if work.has_array else send

    def receive(self, work: Work, index: int, handle: OnMessage) -> None:
        """Wait for data, then take all samples."""
        from cyclonedds.core import ReadCondition, SampleState, WaitSet  # noqa: PLC0415
        from cyclonedds.sub import DataReader  # noqa: PLC0415
        from cyclonedds.util import duration  # noqa: PLC0415

        participant, topic, quality = _topic(work)
        reader: Any = DataReader(participant, topic, qos=quality)
        waiting = WaitSet(participant)
        waiting.attach(ReadCondition(reader, SampleState.NotRead))
        ended = False
        while not ended:
            waiting.wait(duration(seconds=1))
            for message in reader.take(100):
                if hasattr(message, "number"):
                    ended = handle(message.number, message.stamp_ns)


def _topic(work: Work) -> tuple[Any, Any, Any]:
    from cyclonedds.core import Policy, Qos  # noqa: PLC0415
    from cyclonedds.domain import Domain, DomainParticipant  # noqa: PLC0415
    from cyclonedds.topic import Topic  # noqa: PLC0415
    from cyclonedds.util import duration  # noqa: PLC0415

    domain = Domain(0, CONFIGURATION)
    participant = DomainParticipant(0)
    participant.bench_domain = domain  # it must live as long as the participant
    topic = Topic(participant, work.topic, _message_type(work))
    quality = Qos(Policy.Reliability.Reliable(duration(seconds=10)), Policy.History.KeepAll)
    return participant, topic, quality


def _message_type(work: Work) -> Any:
    from cyclonedds.idl import IdlStruct  # noqa: PLC0415
    from cyclonedds.idl.types import array, float64, int64, uint8  # noqa: PLC0415

    @dataclass
    class Probe(IdlStruct, typename="bench.Probe"):  # type: ignore[misc, call-arg]  # mypy does not see it
        number: int64
        stamp_ns: int64
        x: float64
        y: float64
        z: float64
        roll: float64
        pitch: float64
        yaw: float64

    @dataclass
    class Picture(IdlStruct, typename="bench.Picture"):  # type: ignore[misc, call-arg]
        number: int64
        stamp_ns: int64
        data: array[uint8, work.size_bytes]  # a sequence would arrive as a list of numbers

    return Picture if work.has_array else Probe


PEER = CycloneDDS()
