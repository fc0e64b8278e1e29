"""Two links over a network that loses, delays and breaks: order, duplicates, counts, and what goes first."""

import random
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from robbie_mp.connect.link.header import (
    DATAGRAM_BYTES,
    MAGIC,
    MAX_COUNTS,
    VERSION,
    Beat,
    ChannelId,
    DataHeader,
    Packet,
    pack,
)
from robbie_mp.connect.link.peer import SILENT_NS
from robbie_mp.connect.link.receiving import Arrived, Fate
from robbie_mp.connect.link.sending import SendLimits
from robbie_mp.connect.link.traffic import MANNERS, TrafficClass
from robbie_mp.messages import EmergencyStop
from tests.connect.link._support.network import MS, Conditions, Network, Robot, two_robots

COMMAND = ChannelId("robbie_msgs/msg/DriveCommand", 1, "manual")
STATE = ChannelId("nav_msgs/msg/Odometry", 1, "odom")
RELIABLE = ChannelId("std_msgs/msg/String", 1, "events")
BULK = ChannelId("sensor_msgs/msg/Image", 1, "camera")
STOP = ChannelId("robbie_msgs/msg/EmergencyStop", 1, "emergency_stop")
MAP = ChannelId("nav_msgs/msg/OccupancyGrid", 1, "map")
CHANNELS = {
    COMMAND: TrafficClass.COMMAND,
    STATE: TrafficClass.STATE,
    RELIABLE: TrafficClass.RELIABLE,
    BULK: TrafficClass.BULK,
    STOP: TrafficClass.URGENT,
}
WIFI = Conditions(delay_ns=20 * MS, jitter_ns=15 * MS, loss=0.2, bytes_per_s=625_000)


def numbered(number: int, size: int = 0) -> bytes:
    return number.to_bytes(8, "little") + random.Random(number).randbytes(size)


def numbers(robot: Robot, name: ChannelId) -> list[int]:
    return [int.from_bytes(data[:8], "little") for data in robot.received(name)]


def check_counts(sender: Robot, receiver: Robot, name: ChannelId, sent: int) -> None:
    """The counts balance, and agree with what was sent and received."""
    counts = sender.account(name)
    assert counts.sent == sent
    assert counts.received == len(receiver.received(name))
    assert counts.under_way >= 0
    assert counts.sent == counts.received + counts.replaced + counts.dropped + counts.lost + counts.under_way


@pytest.mark.parametrize("name", CHANNELS, ids=lambda name: CHANNELS[name].name.lower())
def test_a_good_network_carries_every_message_in_order(name: ChannelId) -> None:
    network, red, blue = two_robots(1)
    for number in range(50):
        red.offer(name, CHANNELS[name], numbered(number, 100))
        network.run(0.02)
    network.run(1.0)
    assert numbers(blue, name) == list(range(50))
    check_counts(red, blue, name, 50)
    assert red.account(name).under_way == 0


@pytest.mark.parametrize("traffic", [TrafficClass.URGENT, TrafficClass.RELIABLE, TrafficClass.BULK])
def test_what_is_sent_again_arrives_in_order_although_a_fifth_is_lost(traffic: TrafficClass) -> None:
    network, red, blue = two_robots(2, WIFI)
    name = next(name for name, one in CHANNELS.items() if one is traffic)
    for number in range(100):
        red.offer(name, traffic, numbered(number, 2000))
        network.run(0.05)
    network.run(20.0)
    found = numbers(blue, name)
    assert found == sorted(set(found))
    check_counts(red, blue, name, 100)
    account = red.account(name)
    assert account.under_way == account.lost == account.dropped == 0
    if not MANNERS[traffic].keeps_only_newest:
        assert found == list(range(100))
    assert red.node is not None
    assert red.node.peers["blue"].resent > 0


@pytest.mark.parametrize("name", [COMMAND, STATE], ids=["command", "state"])
def test_what_is_not_sent_again_is_counted_as_lost(name: ChannelId) -> None:
    network, red, blue = two_robots(3, WIFI)
    for number in range(200):
        red.offer(name, CHANNELS[name], numbered(number, 50))
        network.run(0.02)
    network.run(8.0)
    found = numbers(blue, name)
    assert found == sorted(set(found))
    check_counts(red, blue, name, 200)
    account = red.account(name)
    assert 0 < account.lost < 20  # 40 without copies
    assert account.under_way == 0


def test_commands_arrive_in_copies_although_the_network_joins_what_is_sent_at_once() -> None:
    network, red, blue = two_robots(3, Conditions(delay_ns=5 * MS, loss=0.2, joins_datagrams=True))
    network.run(5.0)  # the loss is measured
    before = len(network.carried)
    for number in range(200):
        red.offer(COMMAND, TrafficClass.COMMAND, numbered(number))
        network.run(0.012)  # not all copies have been sent when the next command comes
    network.run(1.0)
    assert len(numbers(blue, COMMAND)) > 185  # 160 without copies
    check_counts(red, blue, COMMAND, 200)
    data = [packet for _, _, packet, _ in network.carried[before:] if isinstance(packet, DataHeader)]
    sequences = [packet.sequence for packet in data if packet.traffic is TrafficClass.COMMAND]
    assert sequences == sorted(sequences)  # no copy follows a newer command


def joining(state_period_ns: int = 0) -> tuple[Network, Robot, Robot]:
    """Two robots over a network that has lost a fifth, so that each datagram goes in three copies."""
    conditions, limits = Conditions(loss=0.2, joins_datagrams=True), SendLimits(100, 1 << 20, state_period_ns)
    network, red, blue = two_robots(3, conditions, limits=limits)
    network.run(5.0)  # the loss is measured
    network.conditions.loss = 0.0
    network.carried.clear()
    return network, red, blue


def arrivals(network: Network, traffic: TrafficClass) -> list[int]:
    """Return when packets of messages arrived, ms."""
    return [
        at_ns // MS
        for at_ns, _, packet, _ in network.carried
        if isinstance(packet, DataHeader) and packet.traffic is traffic and packet.whole
    ]


def test_copies_go_apart_where_the_network_joins_what_is_sent_at_once() -> None:
    network, red, _ = joining()
    red.offer(COMMAND, TrafficClass.COMMAND, numbered(1))
    network.run(0.003)
    red.offer(COMMAND, TrafficClass.COMMAND, numbered(2))  # the copies of the first go no more
    network.run(0.1)
    first_ms, *copies_ms = arrivals(network, TrafficClass.COMMAND)
    assert len(copies_ms) == 3
    assert copies_ms[0] == first_ms + 3
    assert (np.diff(copies_ms) >= 5).all()


def test_copies_of_a_state_that_had_to_wait_go_apart() -> None:
    network, red, _ = joining(state_period_ns=50 * MS)
    for number in range(3):
        red.offer(STATE, TrafficClass.STATE, numbered(number))
        network.run(0.2 if number == 2 else 0.003)
    at_ms = arrivals(network, TrafficClass.STATE)
    assert len(at_ms) == 6
    assert (np.diff(at_ms) >= 5).all()


def test_copies_of_a_message_in_parts_go_at_once() -> None:
    network, red, _ = joining()
    red.offer(COMMAND, TrafficClass.COMMAND, numbered(1, DATAGRAM_BYTES))
    network.run(0.1)
    at_ms = arrivals(network, TrafficClass.COMMAND)
    assert at_ms == 6 * at_ms[:1]


def test_no_copy_of_a_command_comes_after_something_urgent() -> None:
    network, red, blue = joining()
    red.offer(COMMAND, TrafficClass.COMMAND, numbered(1))
    network.run(0.003)
    red.offer(STOP, TrafficClass.URGENT, numbered(2))
    network.run(0.1)
    assert len(arrivals(network, TrafficClass.COMMAND)) == 1
    assert [numbers(blue, name) for name in (COMMAND, STOP)] == [[1], [2]]


def test_no_copy_of_a_command_waits_for_a_link_that_is_down() -> None:
    network, red, _ = joining()
    network.conditions.is_cut = True
    assert red.node is not None
    while red.node.peers["blue"].is_up(network.now_ns + 2 * MS):
        network.run(0.001)
    red.offer(COMMAND, TrafficClass.COMMAND, numbered(1))
    network.run(5.0)
    network.conditions.is_cut = False
    network.run(2.0)
    assert not arrivals(network, TrafficClass.COMMAND)


def test_messages_of_a_channel_of_which_nothing_arrives_are_counted_as_lost() -> None:
    network, red, blue = two_robots(10)
    network.conditions.is_cut = True
    for number in range(5):
        red.offer(STATE, TrafficClass.STATE, numbered(number))
        network.run(0.05)
    network.conditions.is_cut = False
    network.run(2.0)
    assert numbers(blue, STATE) == [4]  # only the newest is sent again
    assert red.account(STATE).lost == 4


@pytest.mark.parametrize("traffic", [TrafficClass.STATE, TrafficClass.RELIABLE])
def test_messages_of_more_channels_than_a_report_tells_about_are_counted_as_lost(
    traffic: TrafficClass,
) -> None:
    network, red, blue = two_robots(seed=4)
    for number in range(MAX_COUNTS + 20):
        red.offer(STATE._replace(topic=f"odom{number}"), traffic, b"data")
    network.run(3.0)
    accounts = [account for account in red.counts.channels() if account.is_sent]
    assert sum(account.received for account in accounts) == len(blue.journal) == MAX_COUNTS
    assert sum(account.lost for account in accounts) == 20
    assert all(account.under_way == 0 for account in accounts)


def test_a_reliable_message_waits_for_ten_seconds_without_a_link() -> None:
    network, red, blue = two_robots(4)
    network.conditions.is_cut = True
    for number in range(100):
        red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(number))
        red.offer(COMMAND, TrafficClass.COMMAND, numbered(number))
        network.run(0.1)
    network.conditions.is_cut = False
    network.run(2.0)
    assert numbers(blue, RELIABLE) == list(range(100))
    check_counts(red, blue, RELIABLE, 100)
    # Those of the first half second were sent before the link was known to be down.
    assert numbers(blue, COMMAND) == []
    assert red.account(COMMAND).dropped > 90
    check_counts(red, blue, COMMAND, 100)


def test_a_full_store_drops_the_oldest_and_counts_them() -> None:
    network, red, blue = two_robots(5, limits=SendLimits(messages=10, bytes=1 << 20, state_period_ns=0))
    network.conditions.is_cut = True
    network.run(1.0)
    for number in range(50):
        red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(number))
    network.conditions.is_cut = False
    network.run(2.0)
    assert numbers(blue, RELIABLE) == list(range(40, 50))
    assert red.account(RELIABLE).dropped == 40
    check_counts(red, blue, RELIABLE, 50)


def test_a_command_is_not_delayed_by_images_that_fill_the_link() -> None:
    conditions = Conditions(delay_ns=50 * MS, bytes_per_s=625_000, queue_bytes=1 << 18)
    network, red, blue = two_robots(6, conditions)
    published: dict[int, int] = {}
    for number in range(600):
        if number % 4 == 0:
            red.offer(BULK, TrafficClass.BULK, numbered(number, 200_000))
        published[number] = network.now_ns
        red.offer(COMMAND, TrafficClass.COMMAND, numbered(number))
        network.run(0.02)
    delays = sorted(
        at_ns - published[int.from_bytes(message.data[:8], "little")]
        for at_ns, message in blue.journal
        if message.name == COMMAND
    )
    assert len(delays) > 590
    assert delays[len(delays) * 99 // 100] < 150 * MS  # a round trip and 50 ms more, as promised
    image_bytes = sum(len(data) for data in blue.received(BULK))
    assert image_bytes > 0.7 * 12.0 * conditions.bytes_per_s


def test_state_is_never_older_than_three_periods_beside_images() -> None:
    conditions = Conditions(delay_ns=20 * MS, jitter_ns=15 * MS, bytes_per_s=625_000)
    network, red, blue = two_robots(7, conditions)
    for number in range(300):
        red.offer(BULK, TrafficClass.BULK, numbered(number, 100_000))
        red.offer(STATE, TrafficClass.STATE, numbered(number, 500))
        network.run(0.1)
    stamps = [(at_ns, message.stamp_ns) for at_ns, message in blue.journal if message.name == STATE]
    ages = [later[0] - stamp_ns for (_, stamp_ns), later in pairwise(stamps)]
    assert max(ages) < 300 * MS


def test_latched_messages_reach_late_robots_and_never_an_older_one_last() -> None:
    network = Network(8)
    red = Robot(network, "red", others=["blue"])
    red.offer(MAP, TrafficClass.RELIABLE, numbered(1), is_latched=True)
    red.offer(MAP, TrafficClass.RELIABLE, numbered(2), is_latched=True)
    network.run(5.0)
    red.offer(MAP, TrafficClass.RELIABLE, numbered(3), is_latched=True)
    blue = Robot(network, "blue", others=["red"])
    network.run(0.3)
    assert numbers(blue, MAP)[-1] == 3
    assert numbers(blue, MAP) == sorted(set(numbers(blue, MAP)))
    assert all(message.is_latched for _, message in blue.journal)


def test_a_restarted_robot_gets_the_latched_messages_at_once(tmp_path: Path) -> None:
    network, red, blue = two_robots(9, folder=tmp_path)
    red.offer(MAP, TrafficClass.RELIABLE, numbered(1), is_latched=True)
    network.run(0.3)
    blue.kill()
    blue.forget()
    blue.journal.clear()
    network.run(1.0)
    blue.start()
    network.run(0.3)
    assert numbers(blue, MAP) == [1]
    red.kill()
    blue.kill()


def test_a_bus_that_is_full_delays_reliable_messages_and_loses_none() -> None:
    network, red, blue = two_robots(10)
    opens_ns = network.now_ns + 1000 * MS
    blue.fate = lambda _message: Fate.PUBLISHED if network.now_ns > opens_ns else Fate.NO_ROOM
    for number in range(10):
        red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(number, 100_000))
    network.run(8.0)
    assert numbers(blue, RELIABLE) == list(range(10))
    check_counts(red, blue, RELIABLE, 10)


def test_what_the_receiver_throws_away_is_dropped() -> None:
    network, red, blue = two_robots(11)

    def only_even(message: Arrived) -> Fate:
        return Fate.REFUSED if message.data[0] % 2 else Fate.PUBLISHED

    blue.fate = only_even
    for number in range(10):
        red.offer(STATE, TrafficClass.STATE, numbered(number))
        network.run(0.01)
    network.run(1.0)
    assert red.account(STATE).dropped == 5
    check_counts(red, blue, STATE, 10)
    assert blue.account(STATE, is_sent=False).received == 5


def test_packets_of_others_than_they_say_and_of_no_link_are_counted() -> None:
    network, red, blue = two_robots(12)
    assert red.node is not None
    session = blue.counts.session
    forged = DataHeader("blue", TrafficClass.STATE, 0, 0, session, red.counts.session, 1, 1, 1, 0, 0, 0, 0)
    network.carry("green", "red", forged, b"")
    network.run(0.1)
    red.take("blue", b"nonsense", b"")
    assert red.node.malformed == 2
    assert red.journal == []


def test_link_of_another_version_is_told_from_packets_of_no_link() -> None:
    network, red, _ = two_robots(12)
    assert red.node is not None
    beat = pack(Beat("blue", 1, 0, network.now_ns, 0, 0, 1, 0))
    for header, version in ((b"nonsense", 0), (MAGIC + bytes([VERSION - 1]) + beat[3:], VERSION - 1)):
        red.take("blue", header, b"")
        assert red.node.peers["blue"].other_version == version
    assert red.node.malformed == 2


@pytest.mark.parametrize("is_robot", [False, True], ids=["link", "robot"])
def test_stop_is_sent_again_to_a_link_that_was_killed_before_it_took_anything(
    is_robot: bool, tmp_path: Path
) -> None:
    network, red, blue = two_robots(9, folder=tmp_path)
    red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(0))
    network.run(0.3)
    red.kill()
    red.start()
    network.run(1.0)  # blue hears the new session, and has taken none of its messages
    network.conditions.is_cut = True
    stop, release = (EmergencyStop(engaged=engaged).encode() for engaged in (True, False))
    for data in (release, stop, stop):
        red.offer(STOP, TrafficClass.URGENT, data)
    red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(1))
    network.run(0.1)
    blue.kill()
    if is_robot:
        blue.forget()
    network.run(SILENT_NS / 1e9)
    red.offer(STOP, TrafficClass.URGENT, release)  # which waits for the link
    network.conditions.is_cut = False
    blue.start()
    network.run(1.5)
    assert [arrived.data for _, arrived in blue.journal if arrived.name == STOP] == [stop, stop, release]
    assert numbers(blue, RELIABLE) == [0]
    for name, lost in ((STOP, 1), (RELIABLE, 1)):
        account = red.account(name)
        assert (account.received, account.lost, account.under_way) == (account.sent - lost, lost, 0)
    red.kill()
    blue.kill()


def test_a_robot_that_has_forgotten_all_counts_from_the_beginning(tmp_path: Path) -> None:
    network, red, blue = two_robots(9, folder=tmp_path)
    for number in range(10):
        red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(number))
    network.run(1.0)
    blue.kill()
    blue.forget()
    blue.start()
    network.run(1.5)
    red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(10))
    network.run(1.0)
    account = red.account(RELIABLE)
    assert (account.sent, account.received, account.lost) == (11, 11, 0)
    red.kill()
    blue.kill()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_doubled_reordered_or_lost_uncounted_whichever_link_is_killed(
    seed: int, tmp_path: Path
) -> None:
    choose = random.Random(seed)
    conditions = Conditions(10 * MS, 8 * MS, loss=choose.choice([0.0, 0.05]), bytes_per_s=1e6)
    network, red, blue = two_robots(seed, conditions, tmp_path)
    sent: dict[ChannelId, int] = dict.fromkeys(CHANNELS, 0)
    full_until_ns = 0
    blue.fate = lambda _: Fate.PUBLISHED if network.now_ns > full_until_ns else Fate.NO_ROOM
    for _ in range(600):
        for name, traffic in CHANNELS.items():
            if red.node is not None and choose.random() < 0.3:
                red.offer(name, traffic, numbered(sent[name], choose.choice([0, 100, 30_000])))
                sent[name] += 1
        if choose.random() < 0.015:
            victim = choose.choice([red, blue])
            if victim.node is None:
                continue
            victim.kill()
            network.at(network.now_ns + choose.randrange(1, 800) * MS, victim.start)
        if choose.random() < 0.01:
            full_until_ns = network.now_ns + choose.randrange(1, 1000) * MS
        if choose.random() < 0.003:
            network.conditions.is_cut = True
            network.at(network.now_ns + choose.randrange(1, 1500) * MS, lambda: restore(network))
        network.run(0.01)
    network.conditions.is_cut = False
    network.run(15.0)
    assert red.sessions + blue.sessions > 4
    for name in CHANNELS:
        found = numbers(blue, name)
        assert found == sorted(set(found)), name
        check_counts(red, blue, name, sent[name])
        assert red.account(name).under_way == 0
    red.kill()
    blue.kill()


def restore(network: Network) -> None:
    network.conditions.is_cut = False


def test_reliable_messages_go_at_once_although_bulk_has_no_room() -> None:
    network, red, _blue = two_robots(6, Conditions(delay_ns=50 * MS, bytes_per_s=2.5e6))
    assert red.node is not None
    bulk, reliable = (
        red.node.peers["blue"].streams[one] for one in (TrafficClass.BULK, TrafficClass.RELIABLE)
    )
    for number in range(20):
        red.offer(BULK, TrafficClass.BULK, numbered(number, 1_000_000))
        assert bulk.has_pending
        red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(number, 100))
        assert not reliable.has_pending
        network.run(0.03)


def test_a_stream_without_reports_sends_one_packet_again_and_not_all() -> None:
    network, red, blue = two_robots(6)
    assert red.node is not None
    peer = red.node.peers["blue"]
    red.offer(BULK, TrafficClass.BULK, numbered(0, 500_000))
    network.run(1.0)
    before = peer.resent
    network.conditions.delay_ns = 400 * MS  # a round trip is longer than the time to the first repetition
    red.offer(BULK, TrafficClass.BULK, numbered(1, 500_000))
    network.run(5.0)
    assert numbers(blue, BULK) == [0, 1]
    assert peer.resent <= before + 2


def test_subscriber_that_has_no_room_for_a_while_gets_everything_afterwards() -> None:
    network, red, blue = two_robots(6, Conditions(delay_ns=2 * MS))
    has_room = True
    blue.fate = lambda _: Fate.PUBLISHED if has_room else Fate.NO_ROOM
    for number in range(160):
        has_room = not 20 <= number < 120
        red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(number, 200))
        network.run(0.05)
    network.run(2.0)
    assert numbers(blue, RELIABLE) == list(range(160))
    assert red.account(RELIABLE).under_way == 0


@pytest.mark.parametrize("traffic", [TrafficClass.URGENT, TrafficClass.RELIABLE, TrafficClass.BULK])
def test_robot_without_room_is_sent_little_again_and_goes_on_as_soon_as_it_has_room(
    traffic: TrafficClass,
) -> None:
    network, red, blue = two_robots(6, Conditions(delay_ns=10 * MS))
    name = next(name for name, one in CHANNELS.items() if one is traffic)
    has_room = False
    blue.fate = lambda _: Fate.PUBLISHED if has_room else Fate.NO_ROOM
    for number in range(60):
        red.offer(name, traffic, numbered(number, 2000))
        network.run(0.05)
    found = [
        one.sequence for _, to, one, _ in network.carried if to == "blue" and isinstance(one, DataHeader)
    ]
    ways = 2 if traffic is TrafficClass.URGENT else 1
    assert len(found) - ways * len(set(found)) < 20 * ways
    assert not blue.received(name)
    has_room = True
    network.run(0.006)  # a tick
    assert blue.received(name)
    network.run(1.0)  # meanwhile the window was small
    assert numbers(blue, name)[-1] == 59
    check_counts(red, blue, name, 60)
    assert red.account(name).under_way == red.account(name).lost == red.account(name).dropped == 0


def test_states_that_there_is_no_room_for_are_dropped_and_counted() -> None:
    network, red, blue = two_robots(6)
    has_room = False
    blue.fate = lambda _: Fate.PUBLISHED if has_room else Fate.NO_ROOM
    for number in range(40):
        has_room = number >= 20
        red.offer(STATE, TrafficClass.STATE, numbered(number, 500))
        network.run(0.05)
    network.run(1.0)
    assert numbers(blue, STATE) == list(range(20, 40))
    check_counts(red, blue, STATE, 40)
    assert red.account(STATE).dropped == 20


def test_what_waits_for_room_is_published_while_its_sender_is_silent_only_if_it_is_urgent() -> None:
    network, red, blue = two_robots(6)
    has_room = False
    blue.fate = lambda _: Fate.PUBLISHED if has_room else Fate.NO_ROOM
    red.offer(RELIABLE, TrafficClass.RELIABLE, numbered(0, 100))
    red.offer(STOP, TrafficClass.URGENT, numbered(0, 100))
    network.run(0.2)
    network.conditions.is_cut = True
    network.run(SILENT_NS / 1e9 + 1.0)
    has_room = True
    network.run(0.5)
    assert blue.received(STOP)
    assert not blue.received(RELIABLE)
    network.conditions.is_cut = False
    network.run(3.0)
    assert numbers(blue, RELIABLE) == numbers(blue, STOP) == [0]


def test_everything_urgent_is_sent_again_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    network, red, _ = two_robots(6)
    sent: dict[int, set[int]] = {}

    def lose(_sender: str, receiver: str, packet: object, *_: object, **__: object) -> None:
        if receiver == "blue" and isinstance(packet, DataHeader):
            sent.setdefault(network.now_ns, set()).add(packet.sequence)

    monkeypatch.setattr(network, "carry", lose)
    for number in range(5):
        red.offer(STOP, TrafficClass.URGENT, numbered(number, 100))
        network.run(0.01)
    network.run(0.3)
    assert max(map(len, sent.values())) == 5


def test_odometry_arrives_beside_large_states_over_a_long_and_fast_way() -> None:
    network, red, blue = two_robots(6, Conditions(delay_ns=50 * MS, bytes_per_s=12.5e6))
    scans = [ChannelId("sensor_msgs/msg/LaserScan", 1, name) for name in ("front", "rear")]
    for number in range(100):
        for scan in scans:
            red.offer(scan, TrafficClass.STATE, bytes(12_000))
        red.offer(STATE, TrafficClass.STATE, numbered(number, 500))
        network.run(0.05)
    network.run(1.0)
    assert len(numbers(blue, STATE)) >= 90


def test_states_do_not_pause_while_the_round_trip_is_measured_again() -> None:
    network, red, blue = two_robots(6, Conditions(delay_ns=100 * MS, jitter_ns=30 * MS))
    states = [ChannelId("nav_msgs/msg/Odometry", 1, name) for name in ("odom", "wheels", "goal", "pose")]
    for _ in range(600):
        for name in states:
            red.offer(name, TrafficClass.STATE, bytes(500))
        network.run(0.05)
    arrived = [at for at, one in blue.journal if one.name == states[-1]]
    assert max(after - before for before, after in pairwise(arrived)) < 300 * MS


def test_state_that_is_replaced_keeps_its_turn() -> None:
    network, red, blue = two_robots(6, Conditions(delay_ns=5 * MS, bytes_per_s=100_000))
    scan = ChannelId("sensor_msgs/msg/LaserScan", 1, "scan")
    for number in range(200):
        if number % 10 == 0:
            red.offer(scan, TrafficClass.STATE, bytes(30_000))
        red.offer(STATE, TrafficClass.STATE, numbered(number, 500))
        network.run(0.01)
    arrived = [at for at, one in blue.journal if one.name == STATE]
    assert max(after - before for before, after in pairwise(arrived)) < 700 * MS


@pytest.mark.parametrize(("data", "shrinks"), [(bytes(500_000), True), (numbered(1, 500_000), False)])
def test_bulk_is_compressed_only_if_it_becomes_shorter(data: bytes, shrinks: bool) -> None:
    network, red, blue = two_robots(7)
    red.offer(BULK, TrafficClass.BULK, data)
    network.run(1.0)
    assert blue.received(BULK) == [data]
    sizes = {one[2].whole for one in network.carried if isinstance(one[2], DataHeader)}
    assert (max(sizes) < len(data) / 10) == shrinks


@pytest.mark.parametrize("start", [0, 900, 2700])
def test_state_of_several_datagrams_is_sent_again_when_one_of_them_is_lost(
    start: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    network, red, blue = two_robots(8)
    lost: list[DataHeader] = []
    carry = network.carry

    def lose_one(
        sender: str, receiver: str, packet: Packet, payload: bytes, is_datagram: bool = False
    ) -> None:
        if isinstance(packet, DataHeader) and packet.traffic is TrafficClass.STATE and packet.start == start:
            lost.append(packet)
            if len(lost) == 1:
                return
        carry(sender, receiver, packet, payload, is_datagram)

    monkeypatch.setattr(network, "carry", lose_one)
    red.offer(STATE, TrafficClass.STATE, numbered(1, 3000))
    network.run(0.2)
    assert blue.received(STATE) == [numbered(1, 3000)]
    assert len(lost) == 2
    check_counts(red, blue, STATE, 1)
    assert red.account(STATE).received == 1


def test_states_of_several_datagrams_come_once_and_in_order_although_many_are_lost() -> None:
    network, red, blue = two_robots(9, Conditions(delay_ns=20 * MS, loss=0.3, bytes_per_s=625_000))
    for number in range(200):
        red.offer(STATE, TrafficClass.STATE, numbered(number, 3000))
        network.run(0.1)
    network.run(2.0)
    found = numbers(blue, STATE)
    assert found == sorted(set(found))
    assert len(found) > 190
    check_counts(red, blue, STATE, 200)
    assert red.account(STATE).under_way == 0
