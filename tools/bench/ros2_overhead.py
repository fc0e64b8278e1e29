"""The cost of a large image on its way to ROS 2: through the bridge, and from the middleware's own publisher.

    python -m tools.bench.ros2_overhead [--count 100] [--middleware zenoh dds]

Another process receives both with the middleware's own Python API, and acknowledges each image. The two take
turns in one run, so that a busy machine delays both. The times are those from handing an encoded image to the
bridge, or to the publisher, until the receiver has its bytes. Nobody decodes it, and the publisher has the
same settings as the bridge, so all the difference is the bridge's.
"""

import argparse
import os
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from robbie_mp import ModuleHarness
from robbie_mp.link.wire import Endpoints, open_session
from robbie_mp.messages import Header, Image
from robbie_mp.ros2.tokens import Attachment
from robbie_mp.ros2.type_hash import type_hash
from robbie_mp.services.ros2 import Ros2Bridge

HEIGHT, WIDTH = 1080, 1920
DOMAIN = 97
BRIDGED, PLAIN = "bridged", "plain"
WARM_UP = 5
LIMIT_S = 20.0
Send = Callable[[], None]


class NotReceived(RuntimeError):
    """An image did not arrive in time."""


@dataclass(frozen=True)
class Result:
    """Times of both ways over one middleware, s, one for each image."""

    middleware: str
    bridged_s: list[float]
    plain_s: list[float]

    @property
    def ratio(self) -> float:
        """The median time through the bridge, as a multiple of that of the publisher."""
        return statistics.median(self.bridged_s) / statistics.median(self.plain_s)

    def line(self) -> str:
        """Return the result as a line of text."""
        bridged, plain = (statistics.median(one) * 1e3 for one in (self.bridged_s, self.plain_s))
        return (
            f"{self.middleware:>6}: bridge {bridged:.2f} ms, own publisher {plain:.2f} ms, ratio "
            f"{self.ratio:.3f} (medians of {len(self.plain_s)} images of {HEIGHT * WIDTH * 3 / 1e6:.1f} MB)"
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
        bridge, plain = stack.enter_context((_over_zenoh if middleware == "zenoh" else _over_dds)(port))
        command = [sys.executable, "-m", __spec__.name, "--receive", middleware, str(port)]
        receiver = stack.enter_context(
            subprocess.Popen(command, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        )
        stack.callback(receiver.terminate)
        assert receiver.stdout is not None
        receiver.stdout.readline()  # it has joined
        ways = {BRIDGED: bridge, PLAIN: plain}
        _wait_until_both_arrive(ways, receiver)
        times: dict[str, list[float]] = {BRIDGED: [], PLAIN: []}
        for turn in range(count + WARM_UP):
            for name in sorted(ways, reverse=bool(turn % 2)):
                begin = time.perf_counter()
                ways[name]()
                _acknowledged(receiver, name)
                if turn >= WARM_UP:
                    times[name].append(time.perf_counter() - begin)
    return Result(middleware, times[BRIDGED], times[PLAIN])


def _wait_until_both_arrive(ways: dict[str, Send], receiver: "subprocess.Popen[bytes]") -> None:
    """Send until the receiver has discovered both publishers, and take what is on its way."""
    import select  # noqa: PLC0415

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


def _acknowledged(receiver: "subprocess.Popen[bytes]", name: str) -> None:
    assert receiver.stdout is not None
    line = receiver.stdout.readline().decode().strip()
    if line != name:
        raise NotReceived(f"expected {name}, got {line!r}")


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
def _over_zenoh(port: int) -> Iterator[tuple[Send, Send]]:
    """Send over Zenoh; the plain session has the bridge's settings, and attaches what a node does."""
    import zenoh  # noqa: PLC0415

    address = f"tcp/127.0.0.1:{port}"
    with ExitStack() as stack:
        bridged = stack.enter_context(_bridge(middleware="zenoh", connect=[address]))
        further = {"scouting/gossip/enabled": True, "timestamping/enabled": True}
        own = stack.enter_context(open_session(Endpoints("peer", (), (address,), further=further)))
        publisher = own.declare_publisher(
            f"{DOMAIN}/{PLAIN}/{_type()}", congestion_control=zenoh.CongestionControl.DROP
        )
        encoded = _image().encode()

        def plain() -> None:
            publisher.put(encoded, attachment=Attachment(1, time.time_ns(), bytes(16)).encode())

        yield bridged, plain


def _type() -> str:
    return f"sensor_msgs::msg::dds_::Image_/{type_hash(Image)}"


@contextmanager
def _over_dds(_port: int) -> Iterator[tuple[Send, Send]]:
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
        yield bridged, lambda: writer.write(image)


def receive(middleware: str, port: int) -> None:
    """Acknowledge each image that arrives, until the caller ends this process."""
    if middleware == "zenoh":
        further = {"transport/link/rx/max_message_size": 64 << 20}
        listening = Endpoints("peer", (f"tcp/127.0.0.1:{port}",), further=further)
        with open_session(listening) as session:
            for name in (BRIDGED, PLAIN):

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

    from robbie_mp.ros2.dds_side import LOOPBACK, settings_of_domain  # noqa: PLC0415
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
