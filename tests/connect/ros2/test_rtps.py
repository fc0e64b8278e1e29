"""Reliable writers and readers of RTPS over a network that loses and repeats, and hostile bytes."""

import os
import random
from collections.abc import Callable, Iterator
from functools import partial

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robbie_mp.connect.ros2.rtps import participant, wire
from robbie_mp.connect.ros2.rtps.endpoints import (
    AGAIN_BYTES_PER_S,
    MAX_AHEAD,
    MAX_PARTIAL,
    ReliableReader,
    ReliableWriter,
)
from robbie_mp.connect.ros2.rtps.participant import Participant

ALICE, BOB, CAROL = b"A" * 12, b"B" * 12, b"C" * 12
WRITER, READER = b"\x00\x00\x01\x03", b"\x00\x00\x02\x04"


class Network:
    """A writer and readers, of which datagrams get lost or come twice."""

    def __init__(self, loss: float):
        self.random, self.loss = random.Random(1), loss
        self.got: dict[bytes, list[bytes]] = {BOB: [], CAROL: []}
        self.writer = ReliableWriter(WRITER, self.sender(ALICE))
        self.readers = {
            one: ReliableReader(READER, self.sender(one), partial(self.take, one)) for one in (BOB, CAROL)
        }

    def take(self, reader: bytes, sample: wire.Sample) -> None:
        self.got[reader].append(sample.payload.rstrip(b"\0"))

    def sender(self, prefix: bytes) -> Callable[[bytes, list[bytes]], None]:
        def send(to: bytes, parts: list[bytes]) -> None:
            for part in parts:
                for _ in range(self.random.choice((1, 1, 2))):
                    if self.random.random() >= self.loss:
                        self.arrive(to, wire.datagram(prefix, to, [part]))

        return send

    def arrive(self, to: bytes, data: bytes) -> None:
        for one in wire.submessages(data, to):
            if one.kind in (wire.DATA, wire.DATA_FRAG):
                self.readers[to].on_sample(wire.sample_of(one))
            elif one.kind == wire.HEARTBEAT:
                _, writer, first, last = wire.heartbeat_of(one)
                self.readers[to].on_heartbeat(writer, first, last, bool(one.flags & wire.FINAL))
            elif one.kind == wire.GAP:
                _, writer, *numbers = wire.gap_of(one)
                self.readers[to].on_gap(writer, *numbers)  # type: ignore[arg-type]
            else:
                reader, _, base, missing = wire.acknack_of(one)
                self.writer.on_acknack(reader, base, missing)

    def match(self) -> None:
        for one, reader in self.readers.items():
            self.writer.match(one + READER)
            reader.match(ALICE + WRITER)


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_each_reader_gets_what_is_for_it_once(loss: float) -> None:
    network = Network(loss)
    network.writer.write(b"before anybody is there")
    network.match()
    large = b"x" * (3 * wire.FRAGMENT_BYTES + 5)
    for number in range(20):
        network.writer.write(b"%04d" % number, to=BOB if number % 2 else CAROL)
    network.writer.write(large)
    for _ in range(100):
        network.writer.look_after()
    for one, odd in ((BOB, 1), (CAROL, 0)):
        assert sorted(network.got[one]) == sorted([large, *(b"%04d" % n for n in range(odd, 20, 2))])
    assert all(one.acknowledged == 22 for one in network.writer.readers.values())


@pytest.mark.parametrize(("vendor", "base"), [(b"\x01\x0f", 0), (b"\x01\x10", 1)])
def test_request_sent_before_its_writer_was_found_comes_at_once(vendor: bytes, base: int) -> None:
    sent: list[bytes] = []
    reader = ReliableReader(READER, lambda _, parts: sent.extend(parts), lambda _: None)
    reader.match(vendor + ALICE[2:] + WRITER)
    (greeting,) = wire.submessages(wire.datagram(BOB, ALICE, sent), ALICE)
    assert wire.acknack_of(greeting) == (BOB + READER, WRITER, base, [])
    assert not greeting.flags & wire.FINAL


def test_reader_that_has_gone_gets_nothing() -> None:
    network = Network(0.0)
    network.match()
    network.writer.forget(BOB)
    network.readers[BOB].forget(ALICE)
    network.writer.write(b"hello")
    assert network.got == {BOB: [], CAROL: [b"hello"]}


def test_one_small_question_is_not_answered_with_all_that_is_kept() -> None:
    sent: list[int] = []
    writer = ReliableWriter(WRITER, lambda _to, parts: sent.append(sum(map(len, parts))))
    writer.match(BOB + READER)
    for _ in range(64):
        writer.write(bytes(1 << 20))
    sent.clear()
    for _ in range(3):
        writer.on_acknack(BOB + READER, 1, list(range(1, 65)))
    assert AGAIN_BYTES_PER_S <= sum(sent) < 2 * AGAIN_BYTES_PER_S
    assert writer.withheld > 150


def test_heartbeat_says_which_messages_are_not_kept_any_more() -> None:
    sent: list[bytes] = []
    writer = ReliableWriter(WRITER, lambda _to, parts: sent.extend(parts), kept=1)
    writer.match(BOB + READER)
    for _ in range(3):
        writer.write(bytes(2 * wire.FRAGMENT_BYTES))
    sent.clear()
    writer.on_acknack(BOB + READER, 1, [1, 2])
    (answer,) = wire.submessages(wire.datagram(ALICE, BOB, sent), BOB)
    assert answer.kind == wire.HEARTBEAT, "a GAP would hang FastDDS, if it has parts of these messages"
    assert wire.heartbeat_of(answer)[2:] == (3, 3)


def test_reader_that_was_forgotten_gets_no_gap_for_what_it_may_have_in_part() -> None:
    sent: list[bytes] = []
    writer = ReliableWriter(WRITER, lambda _to, parts: sent.extend(parts))
    writer.match(BOB + READER)
    writer.write(bytes(2 * wire.FRAGMENT_BYTES))
    writer.forget(BOB)
    writer.match(BOB + READER)
    sent.clear()
    writer.on_acknack(BOB + READER, 1, [1])
    (answer,) = wire.submessages(wire.datagram(ALICE, BOB, sent), BOB)
    assert answer.kind == wire.HEARTBEAT
    assert wire.heartbeat_of(answer)[2:] == (2, 1)
    writer.write(b"next")
    reader = ReliableReader(READER, lambda *_: None, lambda _: None)
    reader.match(ALICE + WRITER)
    reader.on_heartbeat(ALICE + WRITER, 2, 2, is_final=False)
    assert reader.writers[ALICE + WRITER].base == 2


def test_parts_of_messages_and_numbers_far_ahead_take_little_memory() -> None:
    taken: list[wire.Sample] = []
    reader = ReliableReader(READER, lambda *_: None, taken.append, max_bytes=1000)
    reader.match(ALICE + WRITER)
    sample = wire.Sample(READER, ALICE + WRITER, 1, {}, b"x" * 300)
    for number in range(1, 2 * MAX_AHEAD):
        reader.on_sample(sample._replace(sequence=number, fragment=1, fragment_bytes=300, size=900))
    (proxy,) = reader.writers.values()
    assert len(proxy.partial) <= MAX_PARTIAL
    reader.on_sample(sample._replace(sequence=1, fragment=1, fragment_bytes=300, size=1 << 30))
    for number in range(3, 10_000):
        reader.on_sample(sample._replace(sequence=number))
    assert len(taken) <= MAX_AHEAD
    assert len(proxy.ahead) <= MAX_AHEAD


@given(st.binary(max_size=200), st.integers(0, 255), st.integers(0, 255))
def test_hostile_bytes_are_read_or_refused(data: bytes, kind: int, flags: int) -> None:
    whole = wire.datagram(ALICE, BOB, [wire.submessage(kind, flags, data)])
    for one in (whole, whole[:-3], data):
        try:
            for read in wire.submessages(one, BOB):
                for reading in (wire.sample_of, wire.heartbeat_of, wire.gap_of, wire.acknack_of):
                    reading(read)
                wire.nack_frag_of(read)
        except wire.Wrong:
            pass


def test_time_of_a_sample_is_the_one_that_was_said_last_before_it() -> None:
    (data,) = wire.data_parts(READER, WRITER, 1, b"", b"x")
    half_past_two = wire.submessage(
        wire.INFO_TS, 0, (2).to_bytes(4, "little") + (1 << 31).to_bytes(4, "little")
    )
    nothing = wire.submessage(wire.INFO_TS, wire.NO_TIME, b"")
    whole = wire.datagram(ALICE, BOB, [data, half_past_two, data, data, nothing, data])
    times = [wire.sample_of(one).sent_ns for one in wire.submessages(whole, BOB)]
    assert times == [None, 2_500_000_000, 2_500_000_000, None]


@given(st.binary(min_size=16, max_size=16), st.integers(1, 2**40))
def test_identity_of_a_request_is_read_as_it_was_written(guid: bytes, number: int) -> None:
    parameters, end = wire.parameters_of(wire.related(guid, number))
    assert wire.identity_of(parameters) == (guid, number)
    assert end == len(wire.related(guid, number))
    assert wire.identity_of({}) is None


BUILTIN = participant.ANNOUNCED_AT + participant.PUBLICATIONS + participant.SUBSCRIPTIONS
ENTITIES = [*BUILTIN, WRITER, READER, bytes(4)]
PARAMETERS = st.lists(
    st.tuples(
        st.sampled_from([0x02, 0x05, 0x07, 0x1A, 0x1D, 0x31, 0x32, 0x50, 0x5A, 0x70, 0x71, 0x83, 0x800F]),
        st.one_of(st.binary(max_size=30), st.sampled_from([CAROL + WRITER, wire.text("rq/goRequest")])),
    ),
    max_size=8,
).map(lambda told: wire.PARAMETERS + wire.parameter_list(told))
BODIES = st.builds(
    lambda reader, writer, number, payload: b"".join(wire.data_parts(reader, writer, number, b"", payload)),
    st.sampled_from(ENTITIES),
    st.sampled_from(ENTITIES),
    st.integers(1, 5),
    st.one_of(PARAMETERS, st.binary(max_size=60)),
)
OTHERS = st.builds(
    lambda kind, flags, entities, rest: wire.submessage(kind, flags, b"".join(entities) + rest),
    st.sampled_from([wire.ACKNACK, wire.HEARTBEAT, wire.GAP, wire.NACK_FRAG, wire.DATA, wire.DATA_FRAG]),
    st.integers(0, 7),
    st.lists(st.sampled_from(ENTITIES), max_size=3),
    st.binary(max_size=60),
)


@pytest.fixture(scope="module")
def attacked() -> Iterator[Participant]:
    found = Participant(80 + os.getpid() % 80, "lo", lambda topic: topic.startswith("rq/"))
    found.add_reader("rq/goRequest", "Go", b"", lambda _: None, 1000)
    found.add_writer("rr/goReply", "Go", b"")
    yield found
    found.close()


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(parts=st.lists(st.one_of(BODIES, OTHERS), max_size=6))
def test_hostile_datagrams_do_not_end_a_participant(attacked: Participant, parts: list[bytes]) -> None:
    attacked.take(wire.datagram(CAROL, attacked.prefix, parts), "127.0.0.1")
    assert len(attacked.others) <= 1000
