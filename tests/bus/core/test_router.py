"""Each subscriber gets the messages it asked for, in order, and every message is counted."""

import pytest

from robbie_mp import MessageHandling
from robbie_mp.bus.core import router
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Outbound
from tests.bus.core._support.simulated_run import CREDIT, SimulatedRun, connected

NEWEST = MessageHandling.KEEP_ONLY_NEWEST


def test_every_subscriber_gets_every_message_in_order() -> None:
    run = SimulatedRun()
    publisher, channel, subscribers = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
    received: list[list[int]] = [[], []]
    for value in range(40):
        assert publisher.publish(channel, value)
        run.run_core()
        for journal, subscriber in zip(received, subscribers, strict=True):
            journal.extend(subscriber.handle_all())
    assert received == [list(range(40))] * 2


def test_slow_subscriber_blocks_neither_publisher_nor_others() -> None:
    run = SimulatedRun()
    publisher, channel, (_slow, quick) = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
    received = []
    for value in range(30):
        assert publisher.publish(channel, value)
        run.run_core()
        received += quick.handle_all()
    assert received == list(range(30))


def test_module_with_many_records_holds_up_others_for_one_turn_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(router, "RECORDS_PER_TURN", 2)
    run = SimulatedRun()
    talkative, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    taciturn = run.start(3)
    other = taciturn.advertise()
    taciturn.ready()
    run.run_core()
    for value in range(6):
        talkative.publish(channel, value)
    taciturn.publish(other, 100)
    assert run.router.run_round(), "it has more, though nobody will post the core again"
    assert subscriber.handle_all() == [0, 1, 100]
    run.run_core()
    assert subscriber.handle_all() == [2, 3, 4, 5]


def test_block_is_freed_when_the_last_subscriber_released_it() -> None:
    run = SimulatedRun()
    publisher, channel, (first, second) = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
    publisher.publish(channel, 7)
    run.run_core()
    first.handle_all()
    run.run_core()
    publisher.collect_freed()
    assert publisher.blocks_out
    second.handle_all()
    run.run_core()
    publisher.collect_freed()
    assert not publisher.blocks_out
    assert run.live_handles() == run.live_references() == 0


def test_message_that_nobody_wants_is_freed_at_once() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run)
    publisher.publish(channel, 7)
    run.run_core()
    publisher.collect_freed()
    assert not publisher.blocks_out
    assert run.live_handles() == 0


def test_busy_subscriber_that_keeps_only_the_newest_gets_the_newest_when_it_asks() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, NEWEST)
    publisher.publish(channel, 0)
    run.run_core()
    busy_with = subscriber.take()
    assert busy_with is not None
    for value in range(1, 6):
        publisher.publish(channel, value)
        run.run_core()
    subscriber.endpoint.release(busy_with)
    run.run_core()
    assert subscriber.handle_all() == [5]
    run.run_core()
    assert run.counts(0) == {"routed": 6, "delivered": 2, "replaced": 4, "dropped": 0, "lost": 0}


def test_replaced_message_is_freed_at_once() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, NEWEST)
    for value in range(3):
        publisher.publish(channel, value)
    run.run_core()
    assert subscriber.take() is not None
    publisher.collect_freed()
    assert len(publisher.blocks_out) == 2  # the one being handled and the newest


def test_newest_and_always_subscriptions_of_one_module_keep_the_one_order() -> None:
    run = SimulatedRun()
    publisher = run.start(1)
    numbers, poses = publisher.advertise(), publisher.advertise(type_name="test_msgs/msg/Pose")
    publisher.ready()
    subscriber = run.start(2)
    subscriber.subscribe()
    subscriber.subscribe(NEWEST, type_name="test_msgs/msg/Pose")
    subscriber.ready()
    run.run_core()
    sequences = []
    for value in range(12):
        publisher.publish(poses if value % 3 else numbers, value)
        run.run_core()
        if value % 4 == 0:
            while (delivery := subscriber.take()) is not None:
                sequences.append(delivery.sequence)
                subscriber.endpoint.release(delivery)
                run.run_core()
    assert sequences == sorted(set(sequences))
    assert len(sequences) > 4


def test_queue_beyond_its_bound_drops_the_oldest_and_counts_it() -> None:
    run = SimulatedRun(queue_messages=5)
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(20):
        publisher.publish(channel, value)
        run.run_core()
    received = []
    while values := subscriber.handle_all():
        received += values
        run.run_core()
    assert received == [*range(CREDIT), *range(15, 20)]
    assert run.counts(0)["dropped"] == 20 - CREDIT - 5


def test_queue_is_bounded_by_bytes() -> None:
    run = SimulatedRun(queue_bytes=1000)
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(CREDIT + 4):
        publisher.publish(channel, value, size=400)
        run.run_core()
    received = []
    while values := subscriber.handle_all():
        received += values
        run.run_core()
    assert received == [*range(CREDIT), CREDIT + 2, CREDIT + 3]


def test_topic_subscription_gets_only_its_topic() -> None:
    run = SimulatedRun()
    publisher = run.start(1)
    front, rear = publisher.advertise("laser/front"), publisher.advertise("laser/rear")
    publisher.ready()
    subscriber, listener = run.start(2), run.start(3)
    subscriber.subscribe(topic="laser/front")
    subscriber.ready()
    listener.subscribe()
    listener.ready()
    run.run_core()
    publisher.publish(front, 1)
    publisher.publish(rear, 2)
    run.run_core()
    assert subscriber.handle_all() == [1]
    assert listener.handle_all() == [1, 2]


def test_subscriber_gets_nothing_before_it_is_ready() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run)
    subscriber = run.start(2)
    subscriber.subscribe()
    run.run_core()
    publisher.publish(channel, 1)
    run.run_core()
    assert subscriber.take() is None
    subscriber.ready()
    run.run_core()
    assert subscriber.handle_all() == [1]


def test_pinned_messages_do_not_use_up_credit() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    kept = []
    for value in range(3 * CREDIT):
        publisher.publish(channel, value)
        run.run_core()
        delivery = subscriber.take()
        assert delivery is not None
        subscriber.endpoint.done(delivery)
        kept.append(delivery)
    run.run_core()
    assert len(publisher.blocks_out) == len(kept)
    for delivery in kept:
        subscriber.endpoint.release(delivery)
        run.run_core()
    publisher.collect_freed()
    assert not publisher.blocks_out


def test_full_handle_table_refuses_and_counts_and_gives_the_block_back() -> None:
    run = SimulatedRun(handles=6)
    publisher, channel, _ = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(10):
        publisher.publish(channel, value)
        run.run_core()
    at = run.tables.publisher(1)
    assert run.words[at + layout.PUBLISHER_ROUTED] == 6
    assert run.words[at + layout.PUBLISHER_REFUSED] == 4
    publisher.collect_freed()
    assert len(publisher.blocks_out) == 6


def test_blocks_freed_twice_by_dying_cores_push_none_out_of_the_ring() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run)
    for number in range(layout.MAX_OUTSTANDING):
        assert publisher.publish(channel, number)
        if number >= layout.MAX_OUTSTANDING - 30:
            run.fuse.stores = 0
            run.fuse.deaths = [number % 30]
        run.run_core()
    publisher.collect_freed()
    assert not publisher.blocks_out


def test_refused_message_is_counted_whatever_was_refused_long_before() -> None:
    run = SimulatedRun(handles=1)
    publisher, channel, _ = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 0)
    records = 1 << 16
    for number in range(records + 1):
        if number % records == 0:
            publisher.publish(channel, number)
        else:
            publisher.endpoint.send(Outbound.WAIT_FREED)
        run.run_core()
    assert run.words[run.tables.publisher(1) + layout.PUBLISHER_REFUSED] == 2


def test_message_is_not_taken_for_the_refused_one_whose_number_ends_with_the_same_bits() -> None:
    run = SimulatedRun(handles=1)
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 0)
    publisher.publish(channel, 1)
    run.run_core()
    for _ in range((1 << 16) - 2):
        publisher.endpoint.send(Outbound.WAIT_FREED)
        run.run_core()
    assert subscriber.handle_all() == [0]
    run.run_core()
    publisher.endpoint.send(Outbound.WAIT_FREED)
    run.run_core()
    publisher.publish(channel, 2)
    run.fuse.stores = 0
    run.fuse.deaths = [5]  # while it enters the message
    run.run_core()
    assert run.crashes == 1
    publisher.collect_freed()
    assert len(publisher.blocks_out) == 1, "the block can be used again while it is read"
    assert subscriber.handle_all() == [2]
    assert run.words[run.tables.publisher(1) + layout.PUBLISHER_REFUSED] == 1


def test_times_between_messages_are_summed_up_over_a_restart_of_the_core() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run, MessageHandling.KEEP_ONLY_NEWEST)
    for stamp_us in (1000, 1010, 1030):
        publisher.publish(channel, stamp_us * 1000)
        run.run_core()
    run.restart_core()
    publisher.publish(channel, 1000_000)  # by another thread that was late
    publisher.publish(channel, (1 << 64) - 1)  # garbage
    run.run_core()
    at = run.tables.channel(0)
    longest = 10**9
    assert run.words[at + layout.CHANNEL_LAST_STAMP_NS] == (1 << 64) - 1
    assert run.words[at + layout.CHANNEL_INTERVALS_SQUARED] == 10**2 + 20**2 + 30**2 + longest**2
