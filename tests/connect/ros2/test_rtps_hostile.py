"""Hostile datagrams neither fill the memory of a participant nor end its thread."""

import math
import os
import struct
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing

import pytest

from robbie_mp.connect.ros2.nodes import (
    ALL_SENDERS,
    LATCHED_WAIT_S,
    MAX_KNOWN,
    MAX_OF_ONE,
    MAX_OTHERS,
    MAX_WAITING,
    NAME_WAIT_S,
    Admission,
)
from robbie_mp.connect.ros2.rtps import wire
from robbie_mp.connect.ros2.rtps.endpoints import MAX_PEERS, PartBudget, ReliableReader
from robbie_mp.connect.ros2.rtps.participant import (
    ANNOUNCED_AT,
    MAX_LEASE_S,
    MAX_PARTICIPANTS,
    PUBLICATIONS,
    Participant,
)
from robbie_mp.connect.ros2.side import MAX_LARGEST, MiddlewareInbox, RosChannel
from tests._support.robot import wait_until

WRITER = b"\x01\x10" + bytes(10) + b"\0\0\x01\x03"
READER = b"\0\0\x01\x04"
MAX_BYTES = 4096


def _reader() -> ReliableReader:
    reader = ReliableReader(READER, lambda _to, _parts: None, lambda _sample: None, MAX_BYTES)
    reader.match(WRITER)
    return reader


def _part(number: int) -> wire.Sample:
    return wire.Sample(READER, WRITER, 1, {}, bytes(256), number, 256, MAX_BYTES)


def _kept_bytes(reader: ReliableReader) -> int:
    return sum(
        len(part)
        for proxy in reader.writers.values()
        for one in proxy.partial.values()
        for part in one.parts.values()
    )


def test_parts_behind_the_end_of_a_message_are_not_kept() -> None:
    reader = _reader()
    for number in range(1000, 2000):
        reader.on_sample(_part(number))
    assert _kept_bytes(reader) == 0


def test_gap_up_to_the_last_number_is_refused_and_the_reader_still_greets() -> None:
    numbers = struct.pack("<iIiII8I", 0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 256, *[0xFFFFFFFF] * 8)
    body = READER + WRITER[wire.PREFIX_BYTES :] + numbers
    reader = _reader()
    with pytest.raises(wire.Wrong):
        _, writer, start, base, single = wire.gap_of(wire.Submessage(wire.GAP, 1, body, WRITER[:12]))
        reader.on_gap(writer, start, base, single)
    reader.look_after()


def test_parts_of_many_writers_take_no_more_than_the_budget_and_the_one_that_sends_most_loses() -> None:
    taken: list[wire.Sample] = []
    budget = PartBudget(16 * MAX_BYTES)
    readers = [ReliableReader(READER, lambda *_: None, taken.append, MAX_BYTES, budget) for _ in range(4)]
    honest = b"\x01\x0f" + bytes(10) + b"\0\0\x01\x03"
    for reader in readers:
        reader.match(honest)
    first = _part(1)._replace(writer=honest, size=512)
    readers[0].on_sample(first)
    for number in range(100):
        writer = WRITER[:12] + number.to_bytes(3, "big") + b"\x03"
        for reader in readers:
            reader.match(writer)
            for part in range(1, MAX_BYTES // 256):
                reader.on_sample(_part(part)._replace(writer=writer))
    assert 15 * MAX_BYTES < sum(map(_kept_bytes, readers)) <= 16 * MAX_BYTES
    readers[0].on_sample(first._replace(fragment=2))
    assert [one.writer for one in taken] == [honest]
    for reader in readers:
        reader.forget(WRITER[:12])
    assert not budget._sizes


def test_message_is_as_old_as_its_first_part_though_another_is_sent_again_later() -> None:
    taken: list[wire.Sample] = []
    reader = ReliableReader(READER, lambda *_: None, taken.append, MAX_BYTES)
    reader.match(WRITER)
    whole = _part(1)._replace(size=768)
    reader.on_sample(whole._replace(fragment=3, sent_ns=None))
    reader.on_sample(whole._replace(fragment=1, sent_ns=5, parameters={1: b"request"}))
    reader.on_sample(whole._replace(fragment=2, sent_ns=9))
    assert [(one.sent_ns, one.parameters) for one in taken] == [(5, {1: b"request"})]


def test_message_that_is_too_large_is_counted() -> None:
    counted: list[int] = []
    reader = ReliableReader(
        READER, lambda *_: None, lambda _: None, MAX_BYTES, None, lambda: counted.append(1)
    )
    reader.match(WRITER)
    for _ in range(3):
        reader.on_sample(_part(1)._replace(size=MAX_BYTES + 1))
    assert len(counted) == 1


def test_inbox_keeps_few_large_messages() -> None:
    inbox = MiddlewareInbox(1000, MAX_BYTES, lambda: None)
    channel = RosChannel("/image", "", "", None)  # type: ignore[arg-type]
    for _ in range(100):
        inbox.put(channel, bytes(MAX_BYTES), 0)
        inbox.put_call("/go", bytes(MAX_BYTES), lambda _: None)
    assert inbox.overflowed == 200 - MAX_LARGEST
    assert len([*inbox.take(), *inbox.take_calls()]) == MAX_LARGEST
    inbox.put(channel, bytes(MAX_BYTES), 0)
    assert inbox.overflowed == 200 - MAX_LARGEST


def test_message_that_waited_is_as_old_as_when_it_came() -> None:
    """A sender whose clock is 1 s ahead is not believed, however long its message waited for a name."""
    inbox = MiddlewareInbox(10, MAX_BYTES, lambda: None)
    channel = RosChannel("/cmd_vel", "", "", None)  # type: ignore[arg-type]
    came_ns = time.monotonic_ns() - 1_200_000_000
    sent_ns = time.time_ns() - 1_200_000_000
    inbox.put(channel, b"", sent_ns + 1_000_000_000, came_ns=came_ns)
    inbox.put(channel, b"", sent_ns - 100_000_000, came_ns=came_ns)
    ahead, usual = inbox.take()
    assert ahead.age_s == math.inf
    assert usual.age_s == pytest.approx(0.1, abs=0.05)


@pytest.fixture
def participant() -> Iterator[Participant]:
    admission = Admission(["/slam"], MAX_BYTES)
    NUMBERS.clear()
    with closing(Participant(90 + os.getpid() % 60, "lo", lambda _: True, admission)) as made:
        made.add_reader("rq/goRequest", "Go", b"", lambda _: None, MAX_BYTES)
        yield made


NUMBERS: Counter[tuple[bytes, bytes]] = Counter()


def _told(participant: Participant, prefix: bytes, builtin: bytes, told: list[tuple[int, bytes]]) -> None:
    NUMBERS[prefix, builtin] += 1
    payload = wire.PARAMETERS + wire.parameter_list(told)
    parts = wire.data_parts(bytes(4), builtin, NUMBERS[prefix, builtin], b"", payload)
    participant.take(wire.datagram(prefix, participant.prefix, parts), "127.0.0.1")


def _announce(participant: Participant, prefix: bytes) -> None:
    locator = struct.pack("<iI", 1, 9) + bytes(16)
    forever = struct.pack("<iI", 0x7FFFFFFF, 0)
    _told(participant, prefix, ANNOUNCED_AT[0], [(0x31, locator), (0x32, locator), (0x02, forever)])


def _endpoint(participant: Participant, prefix: bytes, number: int) -> bytes:
    guid = prefix + number.to_bytes(3, "big") + b"\x03"
    told = [(0x5A, guid), (0x05, wire.text("rq/goRequest")), (0x07, wire.text("Go")), (0x1A, b"\2\0\0\0")]
    _told(participant, prefix, PUBLICATIONS[0], told)
    return guid


def test_flood_of_participants_and_endpoints_leaves_room_for_the_nodes_that_match(
    participant: Participant,
) -> None:
    for number in range(3 * MAX_PARTICIPANTS):
        _announce(participant, b"\x01\x0f" + number.to_bytes(10, "big"))
    assert len(participant._peers) == MAX_PARTICIPANTS
    assert all(one.lease_s <= MAX_LEASE_S for one in participant._peers.values())
    hostile = next(iter(reversed(participant._peers)))
    for number in range(3 * MAX_PEERS):
        _endpoint(participant, hostile, number)
    assert len(participant.others) == MAX_PEERS
    (own,) = participant._readers(b"\0\0\1\x04")
    assert not own.writers
    slam = b"\x01\x0f" + b"slam slam "
    guid = slam + b"\0\0\1\x03"
    participant.admission.tell(slam, {guid: "/slam"})
    _announce(participant, slam)
    assert _endpoint(participant, slam, 1) == guid
    assert set(own.writers) == {guid}
    assert hostile not in participant._greeted
    assert slam in participant._greeted


def test_flood_drives_out_no_participant_whose_name_is_still_to_come(
    participant: Participant, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: begun_s)
    slam = b"\x01\x0f" + b"slam slam "
    _announce(participant, slam)
    for number in range(3 * MAX_PARTICIPANTS):
        _announce(participant, b"\x01\x0f" + number.to_bytes(10, "big"))
    assert slam in participant._peers
    monkeypatch.setattr(time, "monotonic", lambda: begun_s + NAME_WAIT_S + 0.1)
    for number in range(3 * MAX_PARTICIPANTS):
        _announce(participant, b"\x01\x10" + number.to_bytes(10, "big"))
    assert slam not in participant._peers
    assert len(participant._peers) == MAX_PARTICIPANTS


def test_endpoints_that_a_flood_kept_out_are_asked_for_again_once_their_node_is_known(
    participant: Participant,
) -> None:
    slam, hostile = b"\x01\x0f" + b"slam slam ", b"\x01\x0fhost host "
    for one in (slam, hostile):
        _announce(participant, one)
    first = _endpoint(participant, slam, 1)
    for number in range(3 * MAX_PEERS):
        _endpoint(participant, hostile, number)
    second = _endpoint(participant, slam, 2)
    assert first in participant.others
    assert second not in participant.others
    reader = participant._builtin_readers[PUBLICATIONS[1]]
    told = reader.writers[slam + PUBLICATIONS[0]]
    assert told.base == 3
    participant.admission.tell(slam, {first: "/slam", second: "/slam"})
    wait_until(lambda: reader.writers[slam + PUBLICATIONS[0]] is not told)
    NUMBERS[slam, PUBLICATIONS[0]] = 0  # it announces its endpoints again
    assert [_endpoint(participant, slam, number) for number in (1, 2)] == [first, second]
    (own,) = participant._readers(b"\0\0\1\x04")
    assert set(own.writers) == {first, second}
    assert len(participant.others) == MAX_PEERS


def _guid(participant: int, endpoint: int = 1) -> bytes:
    return participant.to_bytes(wire.PREFIX_BYTES, "big") + endpoint.to_bytes(4, "big")


def test_flood_of_names_and_of_messages_without_one_is_bounded() -> None:
    admission, delivered = Admission(["/slam"], MAX_BYTES), []
    for number in range(3 * MAX_OTHERS):
        endpoint = _guid(number)
        admission.tell(endpoint, {endpoint: f"/hostile_{number}"})
        admission.take(endpoint, "a message", 1, lambda: delivered.append(b"hostile"))
        admission.take(b"!" + endpoint[1:], "a message", 1, lambda: delivered.append(b"hostile"))
    assert admission.others <= MAX_OTHERS
    assert len(admission._waiting) == MAX_WAITING
    assert admission.refused == 6 * MAX_OTHERS - MAX_WAITING
    admission.tell(b"slam", {b"slam": "/slam"})
    admission.take(b"slam", "a message", 1, lambda: delivered.append(b"slam"))
    assert delivered == [b"slam"]


def test_participant_that_floods_does_not_keep_out_what_waits_for_the_name_of_another() -> None:
    admission, delivered = Admission(["/slam"], MAX_BYTES), []
    admission.take(_guid(1), "a message", 100, lambda: delivered.append("before"))
    for number in range(3 * MAX_WAITING):
        endpoint = _guid(2, number)
        admission.take(endpoint, "a message", 1, lambda: delivered.append("flood"))
    assert admission.refused == 3 * MAX_WAITING - MAX_OF_ONE
    admission.take(_guid(1), "a message", 1, lambda: delivered.append("after"))
    admission.tell(b"slam", {_guid(1): "/slam"})
    assert delivered == ["before", "after"]


def test_participants_that_flood_together_lose_theirs_to_one_that_has_less() -> None:
    admission, delivered = Admission(["/slam"], MAX_BYTES), []
    for number in range(ALL_SENDERS):
        for size in (1, MAX_BYTES - 1):
            admission.take(_guid(number), "a message", size, lambda: delivered.append("flood"))
    assert not admission.refused
    for _ in range(3):
        admission.take(_guid(9), "a message", MAX_BYTES // 4, lambda: delivered.append("slam"))
    admission.tell(b"slam", {_guid(9): "/slam"})
    assert delivered == ["slam"] * 3
    assert sum(one.size for one in admission._waiting) <= ALL_SENDERS * MAX_BYTES


def test_flood_of_names_that_match_is_bounded() -> None:
    admission = Admission(["/slam"], MAX_BYTES)
    for number in range(MAX_KNOWN + 1000):
        endpoint = number.to_bytes(16, "big")
        admission.tell(endpoint, {endpoint: "/slam"})
    assert len(admission._known) == len(admission._of) == MAX_KNOWN


def test_node_stays_admitted_though_another_claimed_it_too() -> None:
    admission = Admission(["/slam"], MAX_BYTES)
    admission.tell(b"slam", {b"a": "/slam"})
    admission.tell(b"hostile", {b"a": "/slam"})
    admission.tell(b"hostile", {})
    assert admission.admits(b"a")
    admission.tell(b"slam", {})
    assert not admission.admits(b"a")


def test_what_comes_before_the_name_of_its_node_is_delivered_in_order_once_that_is_known() -> None:
    admission, delivered = Admission(["/slam"], MAX_BYTES), []
    admission.take(b"a", "a message", 1, lambda: delivered.append(1))
    admission.take(b"b", "a message", 1, lambda: delivered.append(2))
    admission.tell(b"participant", {b"a": "/slam", b"b": "/other"})
    admission.take(b"a", "a message", 1, lambda: delivered.append(3))
    assert (delivered, admission.refused, list(admission.unnamed)) == (
        [1, 3],
        1,
        ["a message of /other is refused: see `nodes`"],
    )
    admission.tell(b"participant", {})
    assert not admission.admits(b"a")


def test_what_a_node_without_a_name_sends_is_refused_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    admission, delivered = Admission(["/slam"], MAX_BYTES), []
    admission.take(b"a", "a message", 1, lambda: delivered.append(1))
    admission.look_after()
    assert not admission.refused
    begun_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: begun_s + 3.0)
    admission.look_after()
    assert (admission.refused, delivered) == (1, [])


def test_latched_message_waits_longer_for_the_name_of_its_node_because_it_comes_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    admission, delivered = Admission(["/slam"], MAX_BYTES), []
    admission.take(b"a", "a map", 1, lambda: delivered.append("a map"), is_latched=True)
    admission.take(b"b", "a map", 1, lambda: delivered.append("another map"), is_latched=True)
    begun_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: begun_s + LATCHED_WAIT_S - 1.0)
    admission.look_after()
    admission.tell(b"participant", {b"a": "/slam"})
    assert (admission.refused, delivered) == (0, ["a map"])
    monkeypatch.setattr(time, "monotonic", lambda: begun_s + LATCHED_WAIT_S + 1.0)
    admission.look_after()
    assert (admission.refused, delivered) == (1, ["a map"])


def test_endpoint_that_is_not_reliable_or_has_another_type_is_counted_once() -> None:
    unfit: list[tuple[bytes, bool]] = []
    with closing(Participant(90 + os.getpid() % 60, "lo", lambda _: True)) as participant:
        participant.on_unfit = lambda other, has_type: unfit.append((other.guid[-4:], has_type))
        participant.add_reader("rt/go/_action/feedback", "Go", b"", lambda _: None, MAX_BYTES)
        prefix = b"\x01\x0fnot reliab"
        _announce(participant, prefix)
        for entity, kind, reliability in (
            (b"\0\0\1\3", "Go", b"\1"),
            (b"\0\0\2\3", "Stop", b"\2"),
            (b"\0\0\3\3", "Go", b"\2"),
        ):
            told = [
                (0x5A, prefix + entity),
                (0x05, wire.text("rt/go/_action/feedback")),
                (0x07, wire.text(kind)),
                (0x1A, reliability + bytes(3)),
            ]
            for _ in range(2):
                _told(participant, prefix, PUBLICATIONS[0], told)
    assert unfit == [(b"\0\0\1\3", True), (b"\0\0\2\3", False)]
