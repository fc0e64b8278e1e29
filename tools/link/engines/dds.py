"""DDS (CycloneDDS): a topic for each class, with the quality of service that fits it."""

import time

from cyclonedds.core import DDSException, Listener, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader

from robbie_mp.connect.ros2.idl_types import raw_type, sample_of, topic_of
from robbie_mp.messages import Message
from robbie_mp.messages.primitives import Array, uint8
from tools.link.engines.side import KEPT, NEWEST_COUNTS, OnMessage

SETTINGS = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="radio0"/></Interfaces><AllowMulticast>false</AllowMulticast>
<MaxMessageSize>1400B</MaxMessageSize><FragmentSize>1300B</FragmentSize></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><LeaseDuration>60s</LeaseDuration>
<Peers><Peer address="{other}"/></Peers></Discovery>
<Internal><Watermarks><WhcHigh>{unacknowledged}B</WhcHigh></Watermarks></Internal>
</Domain></CycloneDDS>"""
UNACKNOWLEDGED_BYTES = 200_000
"""A writer waits while more is not acknowledged: there is no other limit to what it sends."""
PRIORITIES = {topic: len(KEPT) - number for number, topic in enumerate(KEPT)}
HEAD_BYTES = 8
PATIENCE_S = 0.002


class TrialSample(Message, name="link_msgs/msg/TrialSample", version=1):
    """What crosses."""

    data: Array[uint8]  # (N,)


class Dds:
    """An `Engine`."""

    def __init__(self, own: str, other: str, sends: list[str], on_message: OnMessage):
        self._domain = Domain(0, SETTINGS.format(other=other, unacknowledged=UNACKNOWLEDGED_BYTES))
        self._participant = DomainParticipant(0)
        self._raw = raw_type(TrialSample)
        self._writers, self._readers = {}, []
        for topic in KEPT:
            made = topic_of(self._participant, topic, self._raw)
            if topic in sends:
                self._writers[topic] = DataWriter(self._participant, made, _quality(topic))
            else:
                taking = Taking(topic, on_message)
                self._readers.append(DataReader(self._participant, made, _quality(topic), taking))

    def wait_for_room(self, topic: str) -> None:
        """Return at once: a write waits."""

    def send(self, topic: str, data: bytes) -> None:
        """Send a message, or wait until older ones are acknowledged."""
        encoded = b"\0\1\0\0" + len(data).to_bytes(4, "little") + data
        sample = sample_of(self._raw, encoded + bytes(-len(encoded) % 4))
        while True:
            try:
                self._writers[topic].write(sample)
                return
            except DDSException as error:
                if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                    raise
            # `write` would wait with the GIL, and nothing would be taken meanwhile.
            time.sleep(PATIENCE_S)


class Taking(Listener):  # type: ignore[misc, unused-ignore]
    """Takes the messages of one class."""

    def __init__(self, topic: str, on_message: OnMessage):
        super().__init__()
        self._topic, self._on_message = topic, on_message

    def on_data_available(self, reader: DataReader) -> None:
        """Take them."""
        for sample in reader.take(100):
            if hasattr(sample, "raw"):
                size = int.from_bytes(sample.raw[4:HEAD_BYTES], "little")
                self._on_message(self._topic, sample.raw[HEAD_BYTES : HEAD_BYTES + size])


def _quality(topic: str) -> Qos:
    newest_counts = topic in NEWEST_COUNTS
    return Qos(
        Policy.Reliability.BestEffort if newest_counts else Policy.Reliability.Reliable(0),
        Policy.History.KeepLast(1) if newest_counts else Policy.History.KeepAll,
        Policy.Durability.Volatile,
        Policy.TransportPriority(PRIORITIES[topic]),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


ENGINE = Dds
