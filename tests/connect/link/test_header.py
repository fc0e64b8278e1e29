"""Headers survive the way over the network, and no bytes make `unpack` raise."""

from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.connect.link.header import (
    MAGIC,
    MAX_COUNTS,
    MAX_SEQUENCE,
    MAX_WORD,
    ROBOT_NAME,
    VERSION,
    Beat,
    ChannelId,
    DataHeader,
    Packet,
    ReceiverReport,
    pack,
    unpack,
)
from robbie_mp.connect.link.traffic import CLASSES

WORDS = st.integers(0, MAX_WORD)
TIMES = st.integers(-(1 << 63), (1 << 63) - 1)
ROBOTS = st.sampled_from(["red", "b", "Robot-7_x", "r" * 32])
TOPICS = st.text(st.characters(codec="utf-8"), max_size=24)


@st.composite
def data_headers(draw: st.DrawFn) -> DataHeader:
    sequence = draw(st.integers(1, MAX_SEQUENCE))
    whole = draw(st.integers(0, (1 << 32) - 1))
    header = DataHeader(
        draw(ROBOTS),
        draw(st.sampled_from(CLASSES)),
        draw(st.integers(0, 3)),
        draw(st.integers(0, 65535)),
        draw(WORDS),
        draw(WORDS),
        sequence,
        draw(st.integers(1, sequence)),
        draw(st.integers(sequence, MAX_SEQUENCE)),
        draw(st.integers(0, max(0, whole - 1))),
        whole,
        draw(TIMES),
        draw(WORDS),
    )
    if header.start or (not whole and draw(st.booleans())):
        return header
    return header._replace(
        name=ChannelId("sensor_msgs/msg/Image", draw(st.integers(1, (1 << 32) - 1)), draw(TOPICS)),
        size=draw(st.integers(0, (1 << 32) - 1)),
    )


REPORTS = st.builds(
    ReceiverReport,
    ROBOTS,
    st.sampled_from(CLASSES),
    WORDS,
    WORDS,
    st.just(MAX_SEQUENCE + 1),
    st.integers(1, MAX_SEQUENCE + 1),
    st.integers(0, MAX_SEQUENCE),
    st.lists(st.tuples(st.integers(0, 65535), WORDS, WORDS), max_size=20).map(tuple),
    st.booleans(),
)
BEATS = st.builds(Beat, ROBOTS, WORDS, WORDS, TIMES, TIMES, TIMES, WORDS, st.integers(0, 1000))
PACKETS = st.one_of(data_headers(), REPORTS, BEATS)


@settings(max_examples=60)
@given(PACKETS)
def test_every_header_is_unpacked_as_it_was_packed(packet: Packet) -> None:
    assert unpack(pack(packet)) == packet


@settings(max_examples=60)
@given(PACKETS, st.data())
def test_every_changed_header_is_refused_or_keeps_the_limits(packet: Packet, choose: st.DataObject) -> None:
    header = bytearray(pack(packet))
    for _ in range(choose.draw(st.integers(1, 4))):
        header[choose.draw(st.integers(0, len(header) - 1))] = choose.draw(st.integers(0, 255))
    found = unpack(bytes(header))
    if found is not None:
        assert pack(found) == bytes(header)
        assert ROBOT_NAME.fullmatch(found.robot)


@settings(max_examples=60)
@given(PACKETS, st.binary(min_size=1, max_size=8))
def test_a_header_that_is_cut_or_has_more_at_its_end_is_refused(packet: Packet, more: bytes) -> None:
    header = pack(packet)
    assert unpack(header + more) is None
    assert unpack(header[: -len(more)]) is None


@settings(max_examples=60)
@given(st.binary(max_size=200))
def test_no_bytes_make_unpack_raise(rest: bytes) -> None:
    assert unpack(rest) is None
    for kind in range(5):
        unpack(MAGIC + bytes([VERSION, kind]) + rest + b"\x03red")


def test_a_header_that_names_too_much_is_refused() -> None:
    name = ChannelId("sensor_msgs/msg/Image", 1, "camera")
    good = DataHeader("red", CLASSES[2], 0, 1, 7, 8, 5, 1, 9, 0, 10, 0, 0, name, 10)
    assert unpack(pack(good)) == good
    bad: list[Packet] = [
        good._replace(robot="*"),
        good._replace(start=5),
        good._replace(name=None, size=0),
        good._replace(start=10, name=None, size=0),
        good._replace(sending=4),
        good._replace(sending=MAX_SEQUENCE + 1),
        good._replace(oldest=6),
        good._replace(oldest=0),
        good._replace(flags=4),
        good._replace(name=name._replace(type_name="no type")),
        good._replace(name=name._replace(version=0)),
        good._replace(name=name._replace(topic="x" * 97)),
        ReceiverReport("red", CLASSES[0], 1, 2, 3, 3, 0, ((0, 0, 0),) * (MAX_COUNTS + 1)),
        ReceiverReport("red", CLASSES[0], 1, 2, 3, 0, 0, ()),
        ReceiverReport("red", CLASSES[0], 1, 2, 3, 4, 0, ()),
        ReceiverReport("red", CLASSES[0], 1, 2, MAX_SEQUENCE + 2, 3, 0, ()),
        ReceiverReport("red", CLASSES[0], 1, 2, 3, 3, MAX_SEQUENCE + 1, ()),
    ]
    assert [unpack(pack(packet)) for packet in bad] == [None] * len(bad)


def test_headers_of_other_versions_are_refused() -> None:
    good = pack(Beat("red", 1, 2, 3, 0, 0))
    assert unpack(good) is not None
    for version in (VERSION - 1, VERSION + 1):
        assert unpack(MAGIC + bytes([version]) + good[len(MAGIC) + 1 :]) is None
