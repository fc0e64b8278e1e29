"""What the network hands over: at once if nobody else works with the link, else from a bounded queue."""

import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
import zenoh

from robbie_mp.connect.link import wire as wire_module
from robbie_mp.connect.link.header import PART_BYTES, Beat, ReceivedPacket, pack
from robbie_mp.connect.link.turns import Turns
from robbie_mp.connect.link.wire import DECLARE_NS, PACKETS, Endpoints, InboxLimits, Wire
from tests._support.robot import wait_until

LIMITS = InboxLimits(packets=100, bytes=2 * PART_BYTES)
HEADER = pack(Beat("red", 1, 2, 3, 4, 5))


class Bytes(bytes):
    """Bytes as Zenoh has them."""

    def to_bytes(self, *_: Any, **__: Any) -> bytes:
        """Return a copy."""
        return bytes(self)


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    """Robot blue's, over no network."""
    monkeypatch.setattr(wire_module, "open_session", lambda _endpoints: MagicMock())
    yield Wire("blue", 1, Endpoints(), LIMITS, MagicMock())


def arrive(wire: Wire, count: int, size: int) -> list[bytes]:
    """Have packets of robot red arrive, in this thread; return their payloads."""
    payloads = [number.to_bytes(4, "little") + bytes(size - 4) for number in range(count)]
    for payload in payloads:
        sample: Any = SimpleNamespace(
            key_expr=f"{PACKETS}/blue/red", attachment=Bytes(HEADER), payload=Bytes(payload)
        )
        wire._on_sample(sample)
    return payloads


def test_what_waits_is_bounded_by_bytes_and_the_rest_is_counted(wire: Wire) -> None:
    payloads = arrive(wire, 6, PART_BYTES // 2)
    assert wire.overflowed == 3
    assert [one.payload for one in wire.received()] == payloads[:3]  # each with a header
    assert arrive(wire, 3, PART_BYTES // 2) == [one.payload for one in wire.received()]
    assert wire.overflowed == 3


def test_what_waits_is_bounded_by_packets(wire: Wire) -> None:
    arrive(wire, 103, 10)
    assert (wire.overflowed, len(list(wire.received()))) == (3, 100)


def test_packets_are_handed_over_at_once_and_wait_in_order_while_somebody_has_the_turn(wire: Wire) -> None:
    taken: list[ReceivedPacket] = []
    wire.take_at_once(taken.append)
    payloads = arrive(wire, 5, 100)
    assert len(taken) == 5
    with wire.turns:
        payloads += arrive(wire, 5, 100)
        assert len(taken) == 5
    payloads += arrive(wire, 5, 100)
    assert len(taken) == 5  # behind those that wait
    taken += wire.received()
    payloads += arrive(wire, 5, 100)
    assert [one.payload for one in taken] == payloads
    wire.take_at_once(None)
    arrive(wire, 1, 100)
    assert wire.something_waits


def test_an_exception_in_a_thread_of_zenoh_reaches_the_module(wire: Wire) -> None:
    def fail(_packet: ReceivedPacket) -> None:
        raise ValueError("on purpose")

    wire.take_at_once(fail)
    arrive(wire, 1, 10)
    assert wire.something_waits
    with pytest.raises(ValueError, match="on purpose"):
        list(wire.received())
    with pytest.raises(ValueError, match="on purpose"):
        arrive(wire, 1, 10)
        list(wire.received())


def test_nobody_begins_a_turn_while_the_module_has_it_or_waits_for_it() -> None:
    turns = Turns()
    seen: list[bool] = []
    assert turns.begin_at_once()
    assert not turns.begin_at_once()

    def module() -> None:
        with turns:
            seen.append(turns.begin_at_once())

    thread = threading.Thread(target=module)
    thread.start()
    wait_until(lambda: turns.module_waits)
    turns.end()
    thread.join()
    assert seen == [False]
    assert turns.begin_at_once()


def test_a_new_stream_has_the_link_declare_again_and_datagrams_or_the_end_of_one_do_not(wire: Wire) -> None:
    def said_after(kind: zenoh.SampleKind, reliability: zenoh.Reliability, now_ns: int) -> int:
        before = wire._times_said
        event: Any = SimpleNamespace(kind=kind, link=SimpleNamespace(reliability=reliability))
        wire._on_way(event)
        wire.look_after(now_ns)
        return wire._times_said - before

    begins, ends = zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE
    assert said_after(begins, zenoh.Reliability.BEST_EFFORT, DECLARE_NS) == 0
    assert said_after(ends, zenoh.Reliability.RELIABLE, DECLARE_NS) == 0
    assert said_after(begins, zenoh.Reliability.RELIABLE, DECLARE_NS) == 1
    assert said_after(begins, zenoh.Reliability.RELIABLE, 2 * DECLARE_NS - 1) == 0
    assert said_after(ends, zenoh.Reliability.RELIABLE, 2 * DECLARE_NS) == 1  # for the one before
