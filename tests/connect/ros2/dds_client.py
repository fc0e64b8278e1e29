"""A client of a service over DDS, with CycloneDDS's own types: it shares no code with the bridge.

As rmw_cyclonedds, it puts its number and that of the request before the request, and finds them before the
response. It writes one line of JSON about the response and about who sent it. With a second argument, it is a
node that serves instead, until it is ended.
"""

# mypy: disable-error-code="misc, call-arg"
import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int64, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

SETTINGS = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
ME, NUMBER = 0x1122334455667788, 5


@dataclass
class Request(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Request_"):
    guid: uint64
    seq: int64
    data: bool


@dataclass
class Response(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Response_"):
    guid: uint64
    seq: int64
    success: bool
    message: str


def main(domain: int) -> None:
    kept = Domain(domain, SETTINGS)
    participant = DomainParticipant(domain)
    reliable = Qos(Policy.Reliability.Reliable(0), Policy.History.KeepLast(10))
    writer = DataWriter(participant, Topic(participant, "rq/goRequest", Request), reliable)
    while not writer.get_matched_subscriptions():
        time.sleep(0.01)
    # Its reader comes only now, so the service has not discovered it when the request arrives.
    writer.write(Request(ME, NUMBER, False))
    reader = DataReader(participant, Topic(participant, "rr/goReply", Response), reliable)
    found: list[Response] = []
    while not found:
        found = reader.take(1)
        time.sleep(0.01)
    (sender,) = reader.get_matched_publications()
    endpoint = reader.get_matched_publication_data(sender)
    response = found[0]
    told = {
        "response": [response.guid, response.seq, response.success, response.message],
        "type": endpoint.type_name,
        "user_data": endpoint.qos[Policy.Userdata].data.decode(),
    }
    print(json.dumps(told), flush=True)
    del kept


def serve(domain: int, name: str) -> None:
    kept = Domain(domain, SETTINGS)
    participant = DomainParticipant(domain)
    reliable = Qos(Policy.Reliability.Reliable(0), Policy.History.KeepLast(10))
    reader = DataReader(participant, Topic(participant, f"rq{name}Request", Request), reliable)
    writer = DataWriter(participant, Topic(participant, f"rr{name}Reply", Response), reliable)
    while kept:
        for one in reader.take(10):
            writer.write(Response(one.guid, one.seq, one.data, f"request {one.seq}"))
        time.sleep(0.01)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        serve(int(sys.argv[1]), sys.argv[2])
    main(int(sys.argv[1]))
