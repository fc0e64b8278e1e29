"""A process with CycloneDDS's own types, as its users write them: it shares no code with the bridge.

It writes lines of JSON about what it sees, until its input ends.
"""

# mypy: disable-error-code="misc, call-arg"
import json
import sys
import time
from dataclasses import dataclass
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, bounded_str, float32, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

SETTINGS = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16]


@dataclass
class Node(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: bounded_str[256]
    node_name: bounded_str[256]
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class Nodes(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[Node]


def main(domain: int) -> None:
    kept = Domain(domain, SETTINGS)
    participant = DomainParticipant(domain)
    once = Policy.History.KeepLast(1)
    latched = Qos(Policy.Reliability.Reliable(0), Policy.Durability.TransientLocal, once)
    best_effort = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile)
    readers = {
        "scan": DataReader(participant, Topic(participant, "rt/scan", LaserScan), best_effort),
        "name": DataReader(participant, Topic(participant, "rt/name", String), latched),
        "nodes": DataReader(participant, Topic(participant, "ros_discovery_info", Nodes), latched),
    }
    # The bridge sends scans as best effort, so a reader that needs all of them does not fit.
    strict = Qos(Policy.Reliability.Reliable(0))
    unfit = DataReader(participant, readers["scan"].topic, strict)
    # And one that takes scans for texts is of another type.
    other = DomainParticipant(domain)
    confused = DataReader(other, Topic(other, "rt/scan", String), best_effort)
    endpoints = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    velocity = DataWriter(participant, Topic(participant, "rt/cmd_vel", Twist), strict)
    text = DataWriter(participant, Topic(participant, "rt/text", String), latched)
    text.write(String("from DDS"))
    seen: set[str] = set()
    scan_key = b""
    while len(seen) < 6:
        velocity.write(Twist(Vector3(0.4, 0.0, 0.0), Vector3(0.0, 0.0, 0.1)))
        for what, reader in readers.items():
            for sample in reader.read(10) if what == "nodes" else reader.take(10):
                tell(seen, what, _summary(what, sample))
                if what == "nodes" and scan_key in _writers(sample):
                    tell(seen, "gids", 1)
        for one in endpoints.take(50):
            if one.topic_name == "rt/scan":
                scan_key = one.key.bytes
                user_data = one.qos[Policy.Userdata]
                tell(seen, "endpoint", [one.type_name, user_data.data.decode()])
        if unfit.get_requested_incompatible_qos_status().total_count:
            tell(seen, "unfit", 1)
        time.sleep(0.02)
    sys.stdin.read()
    del kept, confused


def _summary(what: str, sample: Any) -> object:
    if what == "scan":
        return [sample.header.frame_id, list(sample.ranges)]
    if what == "name":
        return sample.data
    return [[one.node_namespace, one.node_name] for one in sample.node_entities_info_seq]


def _writers(nodes: Any) -> list[bytes]:
    return [bytes(gid.data) for node in nodes.node_entities_info_seq for gid in node.writer_gid_seq]


def tell(seen: set[str], what: str, value: object) -> None:
    if what not in seen:
        seen.add(what)
        print(json.dumps([what, value]), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
