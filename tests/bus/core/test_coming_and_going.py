"""Modules die, come back, stay away or break the protocol: messages are counted, others get notices."""

import pytest

from robbie_mp import MessageHandling
from robbie_mp.bus.core.members import MAX_NOTICES
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Delivery, Inbound, Notice, Outbound
from tests.bus.core._support.simulated_run import CREDIT, SimulatedRun, connected


def left_waiting(run: SimulatedRun) -> int:
    """Messages of the first subscription that were dropped when its module was stopped."""
    return run.tables.subscription_row(0).left_waiting(run.counts(0)["dropped"])


def test_restarted_subscriber_continues_with_the_very_next_message() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(10):
        publisher.publish(channel, value)
        run.run_core()
    assert subscriber.take() is not None  # dies while it handles message 0
    run.kill(subscriber)
    publisher.publish(channel, 10)
    run.run_core()
    successor = run.start(2, 2)
    successor.subscribe()
    successor.ready()
    run.run_core()
    received = []
    while values := successor.handle_all():
        received += values
        run.run_core()
    assert received == list(range(1, 11))
    assert run.counts(0) == {"routed": 11, "delivered": 10, "replaced": 0, "dropped": 0, "lost": 1}
    assert run.live_handles() == 0


def test_killed_subscriber_releases_what_it_had_kept() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 1)
    run.run_core()
    delivery = subscriber.take()
    assert delivery is not None
    subscriber.endpoint.done(delivery)
    run.run_core()
    run.kill(subscriber)
    publisher.collect_freed()
    assert not publisher.blocks_out
    assert run.counts(0)["delivered"] == 1


def test_messages_of_a_dead_publisher_are_still_delivered_and_its_segments_go_with_the_last() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(3):
        publisher.publish(channel, value)
    run.kill(publisher)  # the core had not even seen them
    assert (Inbound.SEGMENTS_GONE, 1, 1) not in run.supervisor_notices()
    assert subscriber.handle_all() == [0, 1, 2]
    run.run_core()
    assert (Inbound.SEGMENTS_GONE, 1, 1) in run.supervisor_notices()
    assert run.live_handles() == 0


def test_module_that_will_not_come_back_loses_its_queue_and_it_is_counted() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(5):
        publisher.publish(channel, value)
        run.run_core()
    run.kill(subscriber)
    run.gone(subscriber, clean=False)
    assert run.counts(0) == {"routed": 5, "delivered": 0, "replaced": 0, "dropped": 0, "lost": 5}
    publisher.publish(channel, 5)
    run.run_core()
    assert run.live_handles() == 0


def test_subscription_that_a_restarted_module_no_longer_wants_is_closed() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 0)
    run.run_core()
    run.kill(subscriber)
    successor = run.start(2, 2)
    successor.ready()
    run.run_core()
    publisher.publish(channel, 1)
    run.run_core()
    assert run.counts(0)["dropped"] == 1
    assert run.live_handles() == 0


def test_garbage_in_a_ring_faults_its_module_and_the_others_go_on() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber, hostile) = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
    run.supervisor_notices()
    hostile.endpoint.send(Outbound.RELEASE, 99999999, 1)
    publisher.publish(channel, 1)
    run.run_core()
    assert subscriber.handle_all() == [1]
    assert run.supervisor_notices() == [(Inbound.FAULTED, 3, 1)]
    assert len(run.reports) == 1
    run.kill(hostile)
    run.run_core()
    assert run.live_references() == 1  # its message waits for its next incarnation


def test_notices_never_take_the_room_of_messages() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 7)
    run.run_core()
    assert subscriber.handle_all() == [7]
    for incarnation in range(1, 20):
        run.kill(run.start(3, incarnation))
    for value in range(CREDIT):
        publisher.publish(channel, value)
    run.run_core()
    received, notices = [], 0
    for _ in range(CREDIT + 19):
        record = subscriber.endpoint.take()
        if isinstance(record, Delivery):
            received.append(record.stamp_ns)
            subscriber.endpoint.release(record)
        else:
            notices += record is not None
        run.run_core()
    assert received == list(range(CREDIT))
    assert notices == 19


def test_module_that_was_never_sent_a_message_is_sent_no_notices() -> None:
    run = SimulatedRun()
    _, _, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    run.kill(run.start(3, 1))
    run.run_core()
    assert subscriber.endpoint.take() is None


@pytest.mark.slow
def test_notices_for_a_module_that_takes_none_are_bounded() -> None:
    run = SimulatedRun()
    publisher, channel, (stopped,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 1)
    run.run_core()
    assert stopped.handle_all() == [1]
    for incarnation in range(1, 2 * MAX_NOTICES):
        run.kill(run.start(3, incarnation))
        run.supervisor_notices()
    unmap = []
    while (record := stopped.endpoint.take()) is not None:
        unmap.append(record)
        run.run_core()
    assert MAX_NOTICES <= len(unmap) < MAX_NOTICES + layout.inbound_records(CREDIT)
    assert [record.incarnation for record in unmap if isinstance(record, Notice)] == [
        *range(1, len(unmap) + 1)
    ]


def test_messages_that_waited_when_a_module_was_stopped_can_be_told_from_what_did_not_fit() -> None:
    run = SimulatedRun(queue_messages=3)
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(CREDIT + 5):
        publisher.publish(channel, value)
        run.run_core()
    assert run.counts(0)["dropped"] == 2
    run.kill(subscriber)
    for _ in range(2):  # a core that takes over is told again
        run.gone(subscriber, clean=True)
    # Besides the two, what it had not taken waited, and three in the queue.
    assert (run.counts(0)["dropped"], left_waiting(run)) == (2 + CREDIT + 3, CREDIT + 3)


@pytest.mark.slow
def test_module_stopped_and_started_a_thousand_times_keeps_its_subscriptions() -> None:
    run = SimulatedRun(subscriptions=4)
    publisher, channel, _ = connected(run)
    left = routed = 0
    for incarnation in range(1, 1001):
        subscriber = run.start(2, incarnation)
        subscriber.subscribe()
        subscriber.subscribe(MessageHandling.KEEP_ONLY_NEWEST, topic="other")
        subscriber.subscribe_by_patterns("*", "any")
        subscriber.ready()
        run.run_core()
        for value in range(1 + incarnation % 3):
            publisher.publish(channel, value)
        run.run_core()
        assert subscriber.take() is not None
        run.kill(subscriber)
        run.gone(subscriber, clean=True)
        if incarnation % 100 == 0:
            run.restart_core()
        routed += 1 + incarnation % 3
        left += incarnation % 3
        assert left_waiting(run) == left
    assert run.reports == []
    assert run.counts(0) == {"routed": routed, "delivered": 0, "replaced": 0, "dropped": left, "lost": 1000}


def test_module_started_again_without_a_subscription_gets_it_back_when_it_wishes_it_again() -> None:
    run = SimulatedRun(subscriptions=1)
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    run.kill(subscriber)
    without = run.start(2, 2)
    without.ready()
    run.run_core()
    publisher.publish(channel, 1)
    run.run_core()
    run.kill(without)
    successor = run.start(2, 3)
    successor.subscribe()
    successor.ready()
    run.run_core()
    publisher.publish(channel, 2)
    run.run_core()
    assert successor.handle_all() == [2]
    assert run.reports == []


def module_that_dies_in_setup(deaths: list[int]) -> SimulatedRun:
    """Play a module that publishes in its setup and dies there; then its message is let go."""
    run = SimulatedRun()
    subscriber = run.start(2)
    subscriber.subscribe()
    subscriber.ready()
    publisher = run.start(1)
    publisher.publish(publisher.advertise(), 7)
    run.kill(publisher)
    run.supervisor_notices()
    assert subscriber.handle_all() == [7]
    run.fuse.stores, run.fuse.deaths = 0, deaths
    run.run_core()
    return run


def test_segments_of_a_module_that_never_got_ready_are_removed_whenever_the_core_dies() -> None:
    for death in range(module_that_dies_in_setup([]).fuse.stores):
        run = module_that_dies_in_setup([death])
        assert run.crashes == 1
        assert (Inbound.SEGMENTS_GONE, 1, 1) in run.supervisor_notices(), death


def start_beside_a_full_table(deaths: list[int]) -> SimulatedRun:
    """Play a module that starts while a message takes the last place that there is for references."""
    run = SimulatedRun(references=1)
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    late = run.start(3)
    run.fuse.stores, run.fuse.deaths = 0, deaths
    publisher.publish(channel, 1)
    late.subscribe()
    late.ready()
    run.run_core()
    assert subscriber.handle_all() == [1]
    run.run_core()
    assert run.counts(0)["delivered"] == 1
    assert run.counts(1)["routed"] == 0, "it came before the subscription"
    assert late.take() is None
    return run


def test_core_takes_over_beside_a_full_table_while_a_module_starts() -> None:
    for death in range(start_beside_a_full_table([]).fuse.stores):
        assert start_beside_a_full_table([death]).crashes == 1


def test_what_a_module_wrote_before_the_core_knew_it_is_seen_without_another_post() -> None:
    run = SimulatedRun()
    run.make(1, 1).ready()
    run.run_core()  # woken by that, but it knows no such module
    run.supervisor.endpoint.send(Outbound.MODULE_UP, 1, 1)
    run.run_core()
    assert run.words[run.tables.publisher(1) + layout.PUBLISHER_READY] == 1


def test_module_that_is_sent_something_and_taken_back_in_one_turn_is_not_woken_when_it_is_closed() -> None:
    """As when two modules die at once, and one has subscribed to the other's `ModuleState`."""
    run = SimulatedRun()
    channel = run.supervisor.advertise()
    module = run.start(1)
    module.subscribe()
    module.ready()
    run.run_core()
    run.supervisor.publish(channel, 7)
    run.kill(module)
    successor = run.start(1, 2)
    successor.subscribe()
    successor.ready()
    run.run_core()
    assert successor.handle_all() == [7]


def test_module_that_dies_with_a_broken_ring_after_a_release_is_not_woken_when_it_is_closed() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(CREDIT + 1):  # one waits, and is sent for the release
        publisher.publish(channel, value)
    run.run_core()
    delivery = subscriber.take()
    assert delivery is not None
    subscriber.endpoint.release(delivery)
    subscriber.endpoint.send(Outbound.MODULE_UP)  # which is not for it to say
    run.kill(subscriber)
    assert run.counts(0)["delivered"] == 1
    assert run.waiting(subscriber.slot) == CREDIT
