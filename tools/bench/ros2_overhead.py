"""The cost of a large image on its way to ROS 2: through the bridge, and from the middleware's own publisher.

    python -m tools.bench.ros2_overhead [--count 100] [--middleware zenoh dds]

Another process receives all with the middleware's own Python API, and acknowledges each image. They take
turns in one run, so that a busy machine delays all. The times are those from handing an encoded image to the
bridge, or to the publisher, until the receiver has its bytes. Nobody decodes it, and the publisher has the
same settings as the bridge, so all the difference is the bridge's. Over Zenoh, another publisher has Zenoh's
default settings, as a program has that sets none.
"""

import argparse
import json
import os
import select
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from robbie_mp import ModuleHarness
from robbie_mp.connect.link.wire import Endpoints, open_session
from robbie_mp.connect.ros2.module import Ros2Bridge
from robbie_mp.connect.ros2.tokens import Attachment
from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.messages import Header, Image

HEIGHT, WIDTH = 1080, 1920
DOMAIN = 97
BRIDGED, PLAIN, DEFAULT = "bridged", "plain", "default"
NAMES = (BRIDGED, PLAIN, DEFAULT)
WARM_UP = 5
LIMIT_S = 20.0
LOST_S = 5.0
"""Time after which an image that has not arrived never will."""
MAX_TRIES = 4
Send = Callable[[], None]


class NotReceived(RuntimeError):
    """An image did not arrive in time."""


@dataclass(frozen=True)
class Result:
    """Times of all ways over one middleware, s, one for each image."""

    middleware: str
    times_s: Mapping[str, list[float]]

    def median_s(self, name: str) -> float:
        """The median time of a way."""
        return statistics.median(self.times_s[name])

    def ratio(self, name: str) -> float:
        """The median time through the bridge, as a multiple of that of another way."""
        return self.median_s(BRIDGED) / self.median_s(name)

    def line(self) -> str:
        """Return the result as a line of text."""
        others = [
            f"{name} publisher {self.median_s(name) * 1e3:.2f} ms, ratio {self.ratio(name):.3f}"
            for name in self.times_s
            if name != BRIDGED
        ]
        count, size = len(self.times_s[PLAIN]), HEIGHT * WIDTH * 3 / 1e6
        return (
            f"{self.middleware:>6}: bridge {self.median_s(BRIDGED) * 1e3:.2f} ms, {', '.join(others)} "
            f"(medians of {count} images of {size:.1f} MB)"
        )


def measure(middleware: str, count: int) -> Result:
    """Send images both ways in turns.

    Args:
        middleware: zenoh or dds.
        count: images each way.

    Raises:
        NotReceived: the receiver has not got an image.
    """
    with ExitStack() as stack:
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        ways = stack.enter_context((_over_zenoh if middleware == "zenoh" else _over_dds)(port))
        command = [sys.executable, "-m", __spec__.name, "--receive", middleware, str(port)]
        receiver = stack.enter_context(
            subprocess.Popen(command, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        )
        stack.callback(receiver.terminate)
        assert receiver.stdout is not None
        receiver.stdout.readline()  # it has joined
        _wait_until_all_arrive(ways, receiver)
        times: dict[str, list[float]] = {name: [] for name in ways}
        names = list(ways)
        for turn in range(count + WARM_UP):
            first = turn % len(names)
            for name in names[first:] + names[:first]:
                took_s = _send_until_acknowledged(ways[name], receiver, name)
                if turn >= WARM_UP:
                    times[name].append(took_s)
    return Result(middleware, times)


def _send_until_acknowledged(send: Send, receiver: "subprocess.Popen[bytes]", name: str) -> float:
    """Return the time of an image, s. On a busy machine, middleware drops some; then it is sent again."""
    assert receiver.stdout is not None
    for _ in range(MAX_TRIES):
        begin = time.perf_counter()
        send()
        if select.select([receiver.stdout], [], [], LOST_S)[0]:
            line = receiver.stdout.readline().decode().strip()
            if line != name:
                raise NotReceived(f"expected {name}, got {line!r}")
            return time.perf_counter() - begin
        print(f"{name}: an image was lost", file=sys.stderr)
    raise NotReceived(f"{name}: {MAX_TRIES} images were lost, one after another")


def _wait_until_all_arrive(ways: dict[str, Send], receiver: "subprocess.Popen[bytes]") -> None:
    """Send until the receiver has discovered all publishers, and take what is on its way."""
    assert receiver.stdout is not None
    seen: set[str] = set()
    end = time.monotonic() + LIMIT_S
    while seen != set(ways) or select.select([receiver.stdout], [], [], 0.5)[0]:
        if time.monotonic() > end:
            raise NotReceived(f"only {seen or 'nothing'} arrived within {LIMIT_S:g} s")
        for name in set(ways) - seen:
            ways[name]()
        while select.select([receiver.stdout], [], [], 0.3)[0]:
            seen.add(receiver.stdout.readline().decode().strip())


def _image() -> Image:
    data = np.random.default_rng(1).integers(0, 255, HEIGHT * WIDTH * 3, np.uint8)
    return Image(
        header=Header(frame_id="camera"),
        height=HEIGHT,
        width=WIDTH,
        encoding="rgb8",
        step=WIDTH * 3,
        data=data,
    )


@contextmanager
def _bridge(**settings: object) -> Iterator[Send]:
    own = {"send": {"Image": f"/{BRIDGED} depth=5"}, "parameters": "none", "emergency_stop": "none"}
    encoded = _image().encode()
    with ModuleHarness(Ros2Bridge, {"domain": DOMAIN, **own, **settings}) as harness:
        yield lambda: harness.send_encoded(Image.type_name, Image.version, encoded, topic="camera")


@contextmanager
def _over_zenoh(port: int) -> Iterator[dict[str, Send]]:
    """Send over Zenoh; the plain session has the bridge's settings, and each attaches what a node does."""
    import zenoh  # noqa: PLC0415

    address = f"tcp/127.0.0.1:{port}"
    drop = zenoh.CongestionControl.DROP
    with ExitStack() as stack:
        bridged = stack.enter_context(_bridge(middleware="zenoh", connect=[address]))
        further = {"scouting/gossip/enabled": True, "timestamping/enabled": True}
        plain = stack.enter_context(open_session(Endpoints("peer", (), (address,), further=further)))
        config = zenoh.Config()
        config.insert_json5("connect/endpoints", json.dumps([address]))
        config.insert_json5("listen/endpoints", json.dumps(["tcp/127.0.0.1:0"]))
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("transport/shared_memory/enabled", "false")  # the receiver has none
        default = stack.enter_context(zenoh.open(config))
        publishers = {
            PLAIN: plain.declare_publisher(
                f"{DOMAIN}/{PLAIN}/{_type()}", congestion_control=drop, express=True
            ),
            # With the default queues, large messages would often be dropped.
            DEFAULT: default.declare_publisher(
                f"{DOMAIN}/{DEFAULT}/{_type()}", congestion_control=zenoh.CongestionControl.BLOCK
            ),
        }
        encoded = _image().encode()

        def send(name: str) -> None:
            publishers[name].put(encoded, attachment=Attachment(1, time.time_ns(), bytes(16)).encode())

        yield {BRIDGED: bridged, PLAIN: partial(send, PLAIN), DEFAULT: partial(send, DEFAULT)}


def _type() -> str:
    return f"sensor_msgs::msg::dds_::Image_/{type_hash(Image)}"


@contextmanager
def _over_dds(_port: int) -> Iterator[dict[str, Send]]:
    """Write over DDS; the plain writer has the bridge's settings, and need not encode the image."""
    from cyclonedds.domain import DomainParticipant  # noqa: PLC0415
    from cyclonedds.pub import DataWriter  # noqa: PLC0415
    from cyclonedds.topic import Topic  # noqa: PLC0415

    from tools.bench import ros2_types  # noqa: PLC0415

    with _bridge(middleware="dds") as bridged:
        participant = DomainParticipant(DOMAIN)
        topic = Topic(participant, f"rt/{PLAIN}", ros2_types.Image)
        writer = DataWriter(participant, topic, ros2_types.reliable())
        image = ros2_types.encoded(_image().encode())
        yield {BRIDGED: bridged, PLAIN: lambda: writer.write(image)}


def receive(middleware: str, port: int) -> None:
    """Acknowledge each image that arrives, until the caller ends this process."""
    if middleware == "zenoh":
        further = {"transport/link/rx/max_message_size": 64 << 20}
        listening = Endpoints("peer", (f"tcp/127.0.0.1:{port}",), further=further)
        with open_session(listening) as session:
            for name in NAMES:

                def on_sample(sample: Any, name: str = name) -> None:
                    sample.payload.to_bytes()
                    _acknowledge(name)

                session.declare_subscriber(f"{DOMAIN}/{name}/{_type()}", on_sample)
            print("ready", flush=True)
            sys.stdin.read()
        return
    from cyclonedds.core import ReadCondition, SampleState, WaitSet  # noqa: PLC0415
    from cyclonedds.domain import Domain, DomainParticipant  # noqa: PLC0415
    from cyclonedds.sub import DataReader  # noqa: PLC0415
    from cyclonedds.topic import Topic  # noqa: PLC0415
    from cyclonedds.util import duration  # noqa: PLC0415

    from robbie_mp.connect.ros2.dds_side import LOOPBACK, settings_of_domain  # noqa: PLC0415
    from tools.bench import ros2_types  # noqa: PLC0415

    domain = Domain(DOMAIN, settings_of_domain(LOOPBACK))
    participant = DomainParticipant(DOMAIN)
    waiting = WaitSet(participant)
    readers = {}
    for name in (BRIDGED, PLAIN):
        readers[name] = DataReader(
            participant, Topic(participant, f"rt/{name}", ros2_types.Image), ros2_types.reliable()
        )
        waiting.attach(ReadCondition(readers[name], SampleState.NotRead))
    print("ready", flush=True)
    while domain is not None:
        waiting.wait(duration(seconds=1))
        for name, reader in readers.items():
            for _ in reader.take(10):
                _acknowledge(name)


def _acknowledge(name: str) -> None:
    os.write(sys.stdout.fileno(), f"{name}\n".encode())  # at once: two threads may acknowledge


def main() -> None:
    """Measure, and print a line for each middleware."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=100, help="images each way (100)")
    parser.add_argument("--middleware", nargs="+", choices=("zenoh", "dds"), default=["zenoh", "dds"])
    parser.add_argument("--receive", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.receive:
        receive(arguments.receive[0], int(arguments.receive[1]))
        return
    for middleware in arguments.middleware:
        print(measure(middleware, arguments.count).line(), flush=True)


if __name__ == "__main__":
    main()
