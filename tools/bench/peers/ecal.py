"""Eclipse eCAL over shared memory, with protobuf for small messages and bytes for large ones."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tools.bench.peers.peer import Handle, Peer, Send
from tools.bench.work import Work

FIELDS = ("x", "y", "z", "roll", "pitch", "yaw")
ACKNOWLEDGE_MS = 1000
"""Time for which a lossless publisher waits for its subscribers."""
REGISTRATION_MS = 200
"""Period of registration. The default is 1000 ms; with a shorter one, processes find each other sooner."""


class ECAL(Peer):
    """Local transport by shared memory. A thread of eCAL runs the callbacks."""

    title = "eCAL"
    package = "eclipse-ecal"
    module = "ecal"
    how = "shared memory; protobuf for small messages, bytes and a separate stamp for arrays; callback"

    @contextmanager
    def publisher(self, work: Work) -> Iterator[Send]:
        """Serialize and send."""
        import ecal.nanobind_core as core  # noqa: PLC0415
        from ecal.msg.proto.core import Publisher  # noqa: PLC0415

        core.initialize(_configuration(core, work), f"{work.topic} publisher")
        if work.has_array:
            if work.count > NUMBERS - 2:
                raise ValueError(f"eCAL's time field has room for {NUMBERS - 2} numbers, not {work.count}")
            raw = core.Publisher(work.topic, config=core.get_publisher_configuration())
            data = b"1" * work.size_bytes

            def send_array(number: int) -> None:
                # eCAL accepts only bytes, so the message is the array alone. Its time field carries the
                # stamp, and the lowest bits of the stamp carry the number.
                raw.send(data, _as_time(number, time.monotonic_ns()))

            yield send_array
        else:
            probe_type = _probe_type()
            # Without this argument, the configuration at the time of eCAL's import would apply.
            publisher = Publisher[Any](probe_type, work.topic, core.get_publisher_configuration())

            def send(number: int) -> None:
                stamp_ns = time.monotonic_ns()
                publisher.send(
                    probe_type(
                        number=number, stamp_ns=stamp_ns, x=1.0, y=2.0, z=3.0, roll=4.0, pitch=5.0, yaw=6.0
                    )
                )

            yield send
        core.finalize()

    def receive(self, work: Work, index: int, handle: Handle) -> None:
        """Wait in the main thread while eCAL's thread runs the callback."""
        import ecal.nanobind_core as core  # noqa: PLC0415
        from ecal.msg.proto.core import Subscriber  # noqa: PLC0415

        core.initialize(_configuration(core, work), f"{work.topic} subscriber {index}")
        ended = threading.Event()

        def on_probe(_publisher: Any, data: Any) -> None:
            if handle(data.message.number, data.message.stamp_ns):
                ended.set()

        def on_array(_publisher: Any, _type: Any, data: Any) -> None:
            if handle(*_of_time(data.send_timestamp)):
                ended.set()

        subscriber: Any
        if work.has_array:
            subscriber = core.Subscriber(work.topic)
            subscriber.set_receive_callback(on_array)
        else:
            subscriber = Subscriber[Any](_probe_type(), work.topic)
            subscriber.set_receive_callback(on_probe)
        ended.wait()
        subscriber.remove_receive_callback()
        core.finalize()


NUMBERS = 1 << 12
"""How many numbers the time of a message with an array can carry. The last two codes are negative numbers."""


def _as_time(number: int, stamp_ns: int) -> int:
    """Return a stamp with a resolution of 4 µs, whose lowest bits are a number."""
    from tools.bench.work import END  # noqa: PLC0415

    code = {END: NUMBERS - 1, -1: NUMBERS - 2}.get(number, number)
    return stamp_ns // NUMBERS * NUMBERS + code


def _of_time(time_ns: int) -> tuple[int, int]:
    """Return the number and the stamp; the stamp is the middle of its possible range."""
    from tools.bench.work import END  # noqa: PLC0415

    stamp, code = divmod(time_ns, NUMBERS)
    number = {NUMBERS - 1: END, NUMBERS - 2: -1}.get(code, code)
    return number, stamp * NUMBERS + NUMBERS // 2


def _configuration(core: Any, work: Work) -> Any:
    configuration = core.get_configuration()
    if work.lossless:
        configuration.publisher.layer.shm.acknowledge_timeout_ms = ACKNOWLEDGE_MS
    configuration.registration.registration_refresh = REGISTRATION_MS
    return configuration


def _probe_type() -> Any:
    """Return the protobuf class of the small message, as protoc would generate it."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory  # noqa: PLC0415

    file = descriptor_pb2.FileDescriptorProto(name="bench.proto", package="bench", syntax="proto3")
    message = file.message_type.add(name="Probe")
    field = descriptor_pb2.FieldDescriptorProto
    for place, name in enumerate(("number", "stamp_ns", *FIELDS), start=1):
        kind = field.TYPE_SFIXED64 if place <= 2 else field.TYPE_DOUBLE
        message.field.add(name=name, number=place, type=kind, label=field.LABEL_OPTIONAL)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("bench.Probe"))


PEER = ECAL()
