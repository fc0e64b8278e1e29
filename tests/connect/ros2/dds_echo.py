"""A process that sends back over DDS what it gets, through types of CycloneDDS made from Jazzy's definitions.

CycloneDDS decodes and encodes each message itself. The definitions are those of rosbags, so neither the types
nor the bytes come from the bridge's code. Arguments: the domain, and the types of /all/t0, /all/t1, …
"""

import sys
import time
from functools import cache
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from tests.connect.ros2.dds_witness import SETTINGS

JAZZY = get_typestore(Stores.ROS2_JAZZY)


@cache
def struct(name: str) -> Any:
    """Return a type of CycloneDDS."""
    package, kind, short = name.split("/")
    fields = {field: member(definition) for field, definition in JAZZY.fielddefs[name][1]}
    dds_name = f"{package}::{kind}::dds_::{short}_"
    return make_idl_struct(f"{short}_", dds_name, fields, bases=())


def member(definition: Any) -> Any:
    """Return the type of a field."""
    kind, about = definition
    if kind is Nodetype.NAME:
        return struct(about)
    if kind is Nodetype.ARRAY:
        return types.array[member(about[0]), about[1]]
    if kind is Nodetype.SEQUENCE:
        return types.sequence[member(about[0])]
    return {"string": str, "bool": bool, "octet": types.uint8}.get(about[0]) or getattr(types, about[0])


def main(domain: int, names: list[str]) -> None:
    """Send everything back, until this process is ended."""
    settled = Domain(domain, SETTINGS)
    participant = DomainParticipant(domain)
    quality = Qos(Policy.Reliability.Reliable(0), Policy.History.KeepLast(10))
    ways = [
        (
            DataReader(participant, Topic(participant, f"rt/all/t{number}", struct(name)), quality),
            DataWriter(participant, Topic(participant, f"rt/back/t{number}", struct(name)), quality),
        )
        for number, name in enumerate(names)
    ]
    while settled:
        for reader, writer in ways:
            for sample in reader.take(10):
                writer.write(sample)
        time.sleep(0.01)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
