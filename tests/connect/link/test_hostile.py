"""A peer that is broken or hostile: what it sends raises nothing, fills no memory, and spoils no counts."""

import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.connect.link import counts as link_counts
from robbie_mp.connect.link import sending
from robbie_mp.connect.link.counts import (
    HANDLING,
    NEXT,
    RECEIVED,
    RECEIVED_BEFORE,
    REFUSED,
    TAKEN,
    CountKey,
    LinkCounts,
)
from robbie_mp.connect.link.header import (
    MAX_COUNTS,
    MAX_SEQUENCE,
    MAX_WORD,
    Beat,
    ChannelId,
    DataHeader,
    ReceivedPacket,
    ReceiverReport,
    pack,
    unpack,
)
from robbie_mp.connect.link.node import LinkNode, NodeSettings, Offered
from robbie_mp.connect.link.receiving import Arrived, Fate, ReceiveStream
from robbie_mp.connect.link.send_window import MAX_BYTES, SendWindow
from robbie_mp.connect.link.sending import (
    MAX_UNREPORTED,
    MAX_URGENT,
    MISSED_BYTES_PER_S,
    MISSED_PER_SETTLED,
    SendLimits,
)
from robbie_mp.connect.link.traffic import CLASSES, TrafficClass
from robbie_mp.connect.link.under_way import MAX_SENDINGS, Arrival, UnderWay
from tests.connect.link._support.network import MS, Conditions, Robot, two_robots

ODOM = ChannelId("nav_msgs/msg/Odometry", 1, "odom")
POSE = ChannelId("geometry_msgs/msg/PoseStamped", 1, "map_pose")
STOP = ChannelId("robbie_msgs/msg/EmergencyStop", 1, "emergency_stop")
COMMAND = ChannelId("robbie_msgs/msg/DriveCommand", 1, "manual")
EVENTS = ChannelId("std_msgs/msg/String", 1, "events")
OTHER = 77
"""The session of the hostile peer."""


class Sent:
    """Keeps what a link sends."""

    joins_datagrams = False

    def __init__(self) -> None:
        self.packets: list[DataHeader | ReceiverReport | Beat] = []
        self.data_bytes = 0

    def send(
        self,
        robot: str,
        packet: DataHeader | ReceiverReport | Beat,
        payload: memoryview | bytes,
        *,
        as_datagram: bool = False,
        at_once: bool = False,
    ) -> None:
        """Keep a header; it must be one that another link takes."""
        header = pack(packet)
        assert unpack(header) == packet
        self.packets.append(packet)
        self.data_bytes += len(header) + len(payload) if isinstance(packet, DataHeader) else 0


class Besieged:
    """A link `red` whose only peer, `blue`, sends what a test chooses."""

    def __init__(self) -> None:
        self.now_ns = 1000 * MS
        self.sent = Sent()
        self.taken: list[Arrived] = []
        self.counts = LinkCounts(None, "link", 5)
        limits = SendLimits(messages=100, bytes=1 << 16, state_period_ns=0)
        self.node = LinkNode(
            "red", 5, self.counts, NodeSettings(limits, 1 << 16, 1 << 16), self.sent, self._take
        )
        self.node.meet("blue")

    def _take(self, message: Arrived) -> Fate:
        self.taken.append(message)
        return Fate.PUBLISHED

    def get(self, packet: DataHeader | ReceiverReport | Beat, payload: bytes = b"") -> None:
        """Take a packet as it comes from the network."""
        received = ReceivedPacket("blue", pack(packet), payload, self.now_ns, is_datagram=False)
        self.node.take_and_tell(received)
        self.node.tell_all(self.now_ns)

    def beat(self) -> None:
        """Have the peer say that it lives."""
        self.get(Beat("blue", OTHER, 5, self.now_ns, 0, 0))

    def run(self, seconds: float, *, name: ChannelId, traffic: TrafficClass, size: int = 10) -> None:
        """Send a message every 10 ms, while the peer says only that it lives."""
        for step in range(round(seconds * 100)):
            if step % 10 == 0:
                self.beat()
            self.node.offer(Offered(name, traffic, bytes(size), self.now_ns), self.now_ns)
            self.node.look_after(self.now_ns)
            self.now_ns += 10 * MS


def data(**changed: object) -> DataHeader:
    whole = DataHeader("blue", TrafficClass.STATE, 0, 1, OTHER, 5, 1, 1, 1, 0, 4, 0, 0, ODOM, 4)
    return whole._replace(**changed)  # type: ignore[arg-type]


@pytest.mark.parametrize("traffic", CLASSES)
def test_greatest_numbers_are_taken_without_an_exception(traffic: TrafficClass) -> None:
    link = Besieged()
    link.get(data(traffic=traffic, sequence=MAX_SEQUENCE, oldest=MAX_SEQUENCE, sending=MAX_SEQUENCE), b"data")
    assert len(link.taken) == 1
    for sequence, sending_number in [
        (MAX_SEQUENCE + 1, MAX_SEQUENCE + 1),
        (MAX_WORD, MAX_WORD),
        (9, 8),
    ]:
        link.get(data(traffic=traffic, sequence=sequence, oldest=1, sending=sending_number), b"data")
    assert link.node.malformed == 3


WORDS = st.one_of(st.integers(0, 6), st.sampled_from([MAX_SEQUENCE, MAX_WORD]), st.integers(0, MAX_WORD))
TIMES = st.one_of(st.just(0), st.integers(-(1 << 63), (1 << 63) - 1))
SESSIONS = st.sampled_from([0, 4, 5, OTHER, OTHER + 1])
NAMES = st.sampled_from([None, ODOM, POSE])
HOSTILE = st.one_of(
    st.builds(
        DataHeader, st.just("blue"), st.sampled_from(CLASSES), st.integers(0, 3), st.integers(0, 3), SESSIONS,
        SESSIONS, WORDS, WORDS, WORDS, st.integers(0, 9), st.integers(0, 9), TIMES, WORDS, NAMES,
        st.integers(0, 9),
    ),
    st.builds(
        ReceiverReport, st.just("blue"), st.sampled_from(CLASSES), SESSIONS, SESSIONS, WORDS, WORDS, WORDS,
        st.lists(st.tuples(st.integers(0, 3), WORDS, WORDS), max_size=3).map(tuple), st.booleans(),
    ),
    st.builds(Beat, st.just("blue"), SESSIONS, SESSIONS, TIMES, TIMES, TIMES, WORDS, st.integers(0, 1000)),
)  # fmt: skip


@settings(max_examples=60)
@given(st.lists(st.tuples(HOSTILE, st.binary(max_size=9)), max_size=30))
def test_no_packets_in_any_order_raise_or_spoil_the_counts(packets: list[tuple[DataHeader, bytes]]) -> None:
    link = Besieged()
    link.counts.row(CountKey("out", "blue", 4, TrafficClass.STATE, 1, *ODOM))[TAKEN] = (
        3  # of an earlier process
    )
    names = {ODOM: TrafficClass.STATE, EVENTS: TrafficClass.RELIABLE, STOP: TrafficClass.URGENT}
    for packet, payload in packets:
        for name, traffic in names.items():
            link.node.offer(Offered(name, traffic, b"12345", link.now_ns), link.now_ns)
        link.get(packet, payload)
        link.node.look_after(link.now_ns)
        link.now_ns += 30 * MS
    for account in link.counts.channels():
        if account.is_sent:
            assert account.under_way >= 0
            assert min(account.sent, account.received, account.lost, account.dropped) >= 0


def test_what_the_peer_never_reports_fills_no_memory() -> None:
    for name, traffic in {COMMAND: TrafficClass.COMMAND, STOP: TrafficClass.URGENT}.items():
        link = Besieged()
        link.run(20.0, name=name, traffic=traffic)
        stream = link.node.peers["blue"].streams[traffic]
        limit = MAX_URGENT if traffic is TrafficClass.URGENT else MAX_UNREPORTED
        assert len(stream.sent) + len(stream.pending) <= limit
        assert len(stream.waiting) <= MAX_URGENT
        (account,) = link.counts.channels()
        assert account.sent == 2000
        assert account.under_way >= 0


@pytest.mark.parametrize(("step", "settles"), [(0, False), (1, False), (1, True)])
@pytest.mark.parametrize("traffic", [TrafficClass.URGENT, TrafficClass.RELIABLE, TrafficClass.BULK])
def test_a_peer_that_always_misses_something_does_not_make_the_link_fill_the_network(
    traffic: TrafficClass, step: int, settles: bool
) -> None:
    link = Besieged()
    link.run(2.0, name=EVENTS, traffic=traffic, size=900)
    stream = link.node.peers["blue"].streams[traffic]
    sent_before, resent_before, settled = link.sent.data_bytes, stream.resent, 0
    for number in range(5000):  # one second
        if number % 500 == 0:
            link.beat()
        following = min(1 + step * number, stream.sequence)
        handled = following if settles else 1
        settled = 1000 * (handled - 1)
        sending_number = stream.under_way.number
        report = ReceiverReport(
            "blue", traffic, OTHER, 5, following, handled, sending_number, (), misses=True
        )
        link.get(report)
        link.now_ns += MS // 5
    ways = 2 if traffic is TrafficClass.URGENT else 1
    waited = 200_000  # and goes for the first time
    limit = waited + 1.3 * MISSED_BYTES_PER_S + MISSED_PER_SETTLED * settled
    assert link.sent.data_bytes - sent_before < ways * limit
    assert stream.resent > resent_before
    assert settles or stream.unheeded > 1000


def test_what_is_lost_is_sent_again_at_once_while_most_of_it_arrives() -> None:
    network, red, blue = two_robots(0, Conditions(delay_ns=5 * MS, loss=0.2, bytes_per_s=2e7))
    for number in range(200):
        red.offer(EVENTS, TrafficClass.RELIABLE, bytes([number]) * 20_000)
        network.run(0.02)
    network.run(5.0)
    assert [message[0] for message in blue.received(EVENTS)] == list(range(200))
    assert red.node is not None
    stream = red.node.peers["blue"].streams[TrafficClass.RELIABLE]
    assert stream.resent > 100
    assert stream.unheeded == 0


def test_what_is_taken_but_never_handled_fills_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sending, "MAX_UNSETTLED_BYTES", 1 << 16)
    link = Besieged()
    peer = link.node.peers["blue"]
    stream = peer.streams[TrafficClass.RELIABLE]
    for _ in range(200):
        link.run(0.1, name=EVENTS, traffic=TrafficClass.RELIABLE, size=1000)
        number = stream.under_way.number
        link.get(ReceiverReport("blue", TrafficClass.RELIABLE, OTHER, 5, stream.sequence + 1, 1, number, ()))
    assert stream.unsettled_bytes < (1 << 16) + 3000
    assert link.counts.channels()[0].dropped > 1000


def test_sendings_without_a_report_are_bounded() -> None:
    under_way = UnderWay()
    for number in range(MAX_SENDINGS + 10):
        under_way.add(number, 100, number)
    assert under_way.bytes == 100 * MAX_SENDINGS


def test_a_peer_that_reports_at_once_does_not_open_the_window_without_end() -> None:
    window = SendWindow()
    for number in range(100):
        window.take(Arrival(100_000, 0, 0, 100_000), number * MS)
    assert window.limit == MAX_BYTES


def test_reports_of_what_was_never_sent_change_nothing_and_are_counted() -> None:
    link = Besieged()
    link.run(0.5, name=EVENTS, traffic=TrafficClass.RELIABLE)
    stream = link.node.peers["blue"].streams[TrafficClass.RELIABLE]
    before = len(stream.sent) + len(stream.pending)
    number, sequence = stream.under_way.number, stream.sequence
    for newest, following in [(number + 1, 1), (number, sequence + 2), (MAX_SEQUENCE, MAX_SEQUENCE + 1)]:
        link.get(ReceiverReport("blue", TrafficClass.RELIABLE, OTHER, 5, following, 1, newest, ((0, 3, 0),)))
    assert len(stream.sent) + len(stream.pending) >= before
    assert link.node.peers["blue"].strange == 3
    assert link.counts.channels()[0].received == 0


def test_a_forged_session_does_not_end_one_that_is_heard_but_a_new_one_follows_a_silent_one() -> None:
    link = Besieged()
    link.run(0.3, name=EVENTS, traffic=TrafficClass.RELIABLE)
    peer = link.node.peers["blue"]
    for forged in (data(session=OTHER + 1), Beat("blue", OTHER + 1, 5, link.now_ns, 0, 0)):
        link.get(forged, b"data" if isinstance(forged, DataHeader) else b"")
    assert (peer.session, peer.sessions, peer.stale) == (OTHER, 1, 2)
    link.get(data(), b"data")
    assert len(link.taken) == 1
    link.now_ns += 501 * MS
    link.get(data(session=OTHER + 1), b"data")
    assert (peer.session, peer.sessions, len(link.taken)) == (OTHER + 1, 2, 2)


def test_a_report_that_was_overtaken_does_not_turn_the_books_back() -> None:
    link = Besieged()
    link.run(0.2, name=ODOM, traffic=TrafficClass.STATE)
    link.beat()
    older = ReceiverReport("blue", TrafficClass.STATE, OTHER, 5, 3, 3, 2, ((0, 2, 0),))
    newer = ReceiverReport("blue", TrafficClass.STATE, OTHER, 5, 6, 6, 5, ((0, 5, 0),))
    for report in (newer, older):
        link.get(report)
    (account,) = link.counts.channels()
    assert (account.received, account.lost) == (5, 0)


def test_a_report_about_an_earlier_session_cannot_tell_more_than_was_sent() -> None:
    link = Besieged()
    row = link.counts.row(CountKey("out", "blue", 4, TrafficClass.STATE, 0, *ODOM))
    row[TAKEN], row[RECEIVED_BEFORE] = 10, 2
    for received in (MAX_WORD, 9):
        link.get(ReceiverReport("blue", TrafficClass.STATE, OTHER, 4, 1, 1, 0, ((0, received, 0),)))
    assert row[RECEIVED] == 0
    link.get(ReceiverReport("blue", TrafficClass.STATE, OTHER, 4, 1, 1, 0, ((0, 7, 1),)))
    assert (row[RECEIVED], row[REFUSED]) == (9, 1)


def test_what_was_settled_without_counts_is_lost_when_a_new_session_knows_nothing() -> None:
    link = Besieged()
    link.run(12.0, name=COMMAND, traffic=TrafficClass.COMMAND)  # more than may be without a report
    link.run(0.5, name=ODOM, traffic=TrafficClass.STATE)
    stream = link.node.peers["blue"].streams[TrafficClass.STATE]
    (number,) = stream.numbers
    settled, too_many = stream.sequence + 1, ((number, 99, 0),)
    link.get(ReceiverReport("blue", TrafficClass.STATE, OTHER, 5, settled, settled, 1, too_many))
    assert link.node.peers["blue"].strange == 1
    link.now_ns += 501 * MS
    link.get(Beat("blue", OTHER + 1, 0, link.now_ns, 0, 0))
    for account in link.counts.channels():
        assert account.lost == account.sent
        assert (account.received, account.under_way) == (0, 0)


def test_a_peer_with_endless_channels_fills_neither_books_nor_memory() -> None:
    link = Besieged()
    for number in range(MAX_COUNTS + 20):
        name = ODOM._replace(topic=f"odom{number}")
        link.get(data(channel=number, sequence=number + 1, sending=number + 1, name=name), b"data")
    assert len(link.taken) == MAX_COUNTS
    assert link.node.peers["blue"].uncounted == 20


def test_full_books_give_each_stream_counts_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_counts, "MAX_ROWS", 2)
    counts = LinkCounts(None, "link", 1)
    rows = [counts.row(CountKey("stream", "blue", session, 0)) for session in range(5)]
    for number, row in enumerate(rows):
        row[NEXT] = number
    assert [row[NEXT] for row in rows] == [0, 1, 2, 3, 4]
    assert counts.unlisted == 3
    assert len(list(counts)) == 2


# -- the newest of each channel ----------------------------------------------------------------------------


def stream_of(counts: LinkCounts, taken: list[Arrived]) -> ReceiveStream:
    def take(message: Arrived) -> Fate:
        taken.append(message)
        return Fate.PUBLISHED

    return ReceiveStream(TrafficClass.STATE, counts.row(CountKey("stream", "blue", OTHER, 2)), take, 1 << 16)


def state(sequence: int, channel: int) -> DataHeader:
    name = (ODOM, POSE)[channel]
    return data(channel=channel, sequence=sequence, oldest=sequence, sending=sequence, name=name)


def test_a_state_that_another_channel_has_overtaken_is_taken_once_and_never_after_a_newer_one() -> None:
    counts, taken = LinkCounts(None, "link", 1), list[Arrived]()
    stream = stream_of(counts, taken)
    for sequence, channel in [(2, 1), (1, 0), (1, 0), (2, 1), (5, 0), (4, 0), (3, 1), (3, 1)]:
        stream.take(state(sequence, channel), b"data")
    assert [message.name for message in taken] == [POSE, ODOM, ODOM, POSE]
    assert stream.duplicates == 4
    assert stream.next == stream.handled == 6


def test_a_restarted_link_takes_no_state_again_that_was_overtaken() -> None:
    counts, taken = LinkCounts(None, "link", 1), list[Arrived]()
    stream = stream_of(counts, taken)
    for sequence, channel in [(2, 1), (1, 0), (6, 1)]:
        stream.take(state(sequence, channel), b"data")
    counts.row(CountKey("stream", "blue", OTHER, 2))[HANDLING] = 4  # killed while it published this one
    again = stream_of(counts, taken)
    assert again.next == 7
    for sequence, channel in [(1, 0), (4, 0), (5, 0)]:
        again.take(state(sequence, channel), b"data")
    assert len(taken) == 3


def test_a_lost_state_is_sent_again_at_once_when_its_loss_is_known() -> None:
    network, red, blue = two_robots(1)
    for number in range(40):
        network.conditions.loss = 1.0 if number % 4 == 2 else 0.0
        red.offer(ODOM, TrafficClass.STATE, bytes([number]))
        network.run(0.02)
        network.conditions.loss = 0.0
        network.run(0.08)
    network.run(0.5)
    assert [message[0] for message in blue.received(ODOM)] == list(range(40))
    account = red.account(ODOM)
    assert (account.received, account.lost, account.under_way) == (40, 0, 0)
    assert_repeats_are_few(red, messages=40)


def assert_repeats_are_few(robot: Robot, messages: int) -> None:
    assert robot.node is not None
    assert 0 < robot.node.peers["blue"].resent < messages


def test_states_of_several_channels_are_repeated_alone_and_in_order() -> None:
    network, red, blue = two_robots(3)
    choose = random.Random(3)
    for number in range(200):
        network.conditions.loss = choose.choice([0.0, 0.0, 0.4])
        for name in (ODOM, POSE):
            red.offer(name, TrafficClass.STATE, number.to_bytes(2, "big"))
        network.run(0.05)
    network.conditions.loss = 0.0
    network.run(2.0)
    for name in (ODOM, POSE):
        found = [int.from_bytes(one, "big") for one in blue.received(name)]
        assert found == sorted(set(found))
        assert len(found) > 190
        account = red.account(name)
        assert account.sent == 200 == account.received + account.replaced + account.lost


def test_a_state_for_a_robot_that_was_restarted_since_is_not_sent_again(tmp_path: Path) -> None:
    network, red, blue = two_robots(5, folder=tmp_path)
    network.conditions.loss = 1.0
    red.offer(ODOM, TrafficClass.STATE, b"lost")
    network.run(0.02)
    blue.kill()
    blue.forget()
    network.conditions.loss = 0.0
    blue.start()
    network.run(1.0)
    assert blue.received(ODOM) == []
    account = red.account(ODOM)
    assert (account.sent, account.lost, account.received) == (1, 1, 0)
    red.offer(ODOM, TrafficClass.STATE, b"next")
    network.run(0.2)
    assert blue.received(ODOM) == [b"next"]
    for robot in (red, blue):
        robot.kill()
