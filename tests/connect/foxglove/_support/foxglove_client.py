"""A plain WebSocket client for Foxglove's protocol, written from its specification alone.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import json
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets.sync.client import ClientConnection, connect

PROTOCOL = "foxglove.sdk.v1"
LIMIT_S = 20.0


class Data(NamedTuple):
    """A message."""

    channel: dict[str, Any]
    time_ns: int
    data: bytes

    def decode(self) -> Any:
        """Decode it with an independent decoder, by the schema that the server has given."""
        channel = self.channel
        schema = Schema(1, channel["schema"].encode(), channel["schemaEncoding"], channel["schemaName"])
        decoder = DecoderFactory().decoder_for("cdr", schema)
        assert decoder is not None
        return decoder(self.data)


class Client:
    """One connection; every wait has a limit."""

    def __init__(self, socket: ClientConnection):
        self._socket = socket
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.parameters: dict[str, Any] = {}
        self.told: list[dict[str, Any]] = []
        self.data: list[Data] = []
        self.responses: dict[int, bytes] = {}
        self.assets: dict[int, bytes | None] = {}
        self.asset_errors: dict[int, str] = {}
        self.times_ns: list[int] = []
        self._subscriptions: dict[int, dict[str, Any]] = {}

    def until(self, condition: Callable[[], object]) -> None:
        """Read until a condition holds."""
        deadline = time.monotonic() + LIMIT_S
        while not condition():
            self._read(self._socket.recv(max(0.0, deadline - time.monotonic())))

    def _read(self, frame: str | bytes) -> None:
        if isinstance(frame, str):
            self._tell(json.loads(frame))
        elif frame[0] == 1:
            number, time_ns = struct.unpack_from("<IQ", frame, 1)
            self.data.append(Data(self._subscriptions[number], time_ns, frame[13:]))
        elif frame[0] == 2:
            self.times_ns.append(struct.unpack_from("<Q", frame, 1)[0])
        elif frame[0] == 3:
            _, call, size = struct.unpack_from("<III", frame, 1)
            assert frame[13 : 13 + size] == b"cdr"
            self.responses[call] = frame[13 + size :]
        elif frame[0] == 4:
            number, status, size = struct.unpack_from("<IBI", frame, 1)
            self.asset_errors[number] = frame[10 : 10 + size].decode()
            self.assets[number] = None if status else frame[10 + size :]

    def _tell(self, told: dict[str, Any]) -> None:
        self.told.append(told)
        if told["op"] == "advertise":
            self.channels |= {one["topic"]: one for one in told["channels"]}
        elif told["op"] == "advertiseServices":
            self.services |= {one["name"]: one for one in told["services"]}
        elif told["op"] == "parameterValues":
            self.parameters |= {one["name"]: one.get("value") for one in told["parameters"]}

    def send(self, op: str, **fields: object) -> None:
        self._socket.send(json.dumps({"op": op, **fields}))

    def subscribe(self, topic: str) -> None:
        self.until(lambda: topic in self.channels)
        number = len(self._subscriptions) + 1
        self._subscriptions[number] = self.channels[topic]
        self.send("subscribe", subscriptions=[{"id": number, "channelId": self.channels[topic]["id"]}])

    def advertise(
        self, number: int, topic: str, schema_name: str, encoding: str = "cdr", **schema: str
    ) -> None:
        channel = {"id": number, "topic": topic, "encoding": encoding, "schemaName": schema_name, **schema}
        self.send("advertise", channels=[channel])

    def publish(self, number: int, data: bytes) -> None:
        self._socket.send(struct.pack("<BI", 1, number) + data)

    def call(self, service: str, data: bytes, call: int) -> None:
        self.until(lambda: service in self.services)
        head = struct.pack("<BIII", 2, self.services[service]["id"], call, 3)
        self._socket.send(head + b"cdr" + data)

    def fetch(self, uri: str, number: int) -> bytes | None:
        self.send("fetchAsset", uri=uri, requestId=number)
        self.until(lambda: number in self.assets)
        return self.assets[number]

    def of(self, topic: str) -> list[Data]:
        """The messages of a topic."""
        return [one for one in self.data if one.channel["topic"] == topic]

    def problems(self) -> list[str]:
        """The warnings that the server has shown."""
        return [one["message"] for one in self.told if one["op"] == "status"]


@contextmanager
def connected(link: str) -> Iterator[Client]:
    """Connect to a link with a token."""
    with connect(link, subprotocols=[PROTOCOL], max_size=None, compression=None) as socket:  # type: ignore[list-item]
        yield Client(socket)
