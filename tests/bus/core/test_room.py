"""Memory stays for those who go on: what a subscriber has in flight, what is dropped in a shortage."""

from typing import Any

import pytest

from robbie_mp import MessageHandling
from robbie_mp.bus.core.router import IN_FLIGHT_SHARE
from robbie_mp.bus.transport.blocks import block_bytes
from robbie_mp.bus.transport.words import WORD_MAX
from tests.bus.core._support.simulated_run import CREDIT, SimulatedModule, SimulatedRun, connected

ALWAYS, NEWEST = MessageHandling.ALWAYS_DELIVER, MessageHandling.KEEP_ONLY_NEWEST
LATER = 1 << 40
SIZE = 1000


def publish(
    run: SimulatedRun, publisher: SimulatedModule, channel: int, count: int, size: int = SIZE
) -> None:
    for value in range(count):
        assert publisher.publish(channel, value, size)
        run.run_core()


def blocks_alive(publisher: SimulatedModule) -> int:
    publisher.collect_freed()
    return len(publisher.blocks_out)


def make_room(
    run: SimulatedRun,
    publisher: SimulatedModule,
    messages: int = CREDIT * 100,
    memory_bytes: int = WORD_MAX,
    before_ns: int = LATER,
) -> None:
    publisher.endpoint.make_room(messages, memory_bytes, before_ns)
    run.run_core()


@pytest.mark.parametrize(
    "limits", [{"in_flight_bytes": 2 * SIZE}, {"memory_bytes": 2 * SIZE * IN_FLIGHT_SHARE}]
)
def test_subscriber_has_few_bytes_of_a_publisher_in_flight(limits: dict[str, Any]) -> None:
    run = SimulatedRun(**limits)
    publisher, channel, (subscriber,) = connected(run, ALWAYS)
    publish(run, publisher, channel, 6)
    assert run.in_hands(2) == 2
    received = []
    for _ in range(6):
        assert run.in_hands(2) <= 2
        received += subscriber.handle_all()
        run.run_core()
    assert received == list(range(6))


def test_message_larger_than_the_window_goes_alone() -> None:
    run = SimulatedRun(in_flight_bytes=10)
    publisher, channel, (subscriber,) = connected(run, ALWAYS)
    publish(run, publisher, channel, 3)
    for value in range(3):
        assert run.in_hands(2) == 1
        assert subscriber.handle_all() == [value]
        run.run_core()


def test_window_of_one_publisher_is_not_used_up_by_another() -> None:
    run = SimulatedRun(in_flight_bytes=SIZE)
    publisher, channel, (subscriber,) = connected(run, ALWAYS)
    other = run.start(3)
    other_channel = other.advertise()
    other.ready()
    run.run_core()
    publish(run, publisher, channel, 1)
    publish(run, other, other_channel, 1)
    assert run.in_hands(2) == 2
    assert len(subscriber.handle_all()) == 2


def test_message_that_is_held_leaves_its_window() -> None:
    run = SimulatedRun(in_flight_bytes=SIZE)
    publisher, channel, (subscriber,) = connected(run, ALWAYS)
    publish(run, publisher, channel, 2)
    held = subscriber.take()
    assert held is not None
    assert subscriber.take() is None
    subscriber.endpoint.done(held)
    run.run_core()
    assert subscriber.handle_all() == [1]


def test_new_core_knows_what_is_in_flight() -> None:
    run = SimulatedRun(in_flight_bytes=2 * SIZE)
    publisher, channel, _ = connected(run, ALWAYS)
    publish(run, publisher, channel, 5)
    run.restart_core()
    run.check_windows()
    publish(run, publisher, channel, 2)
    assert run.in_hands(2) == 2


def test_oldest_messages_that_only_wait_are_dropped_for_a_publisher_short_of_memory() -> None:
    run = SimulatedRun()
    publisher, channel, (stopped,) = connected(run, ALWAYS)
    publish(run, publisher, channel, CREDIT + 8)
    make_room(run, publisher, memory_bytes=(CREDIT + 3) * block_bytes(SIZE))
    assert blocks_alive(publisher) == CREDIT + 3
    assert run.counts(0) == {"routed": CREDIT + 8, "delivered": 0, "replaced": 0, "dropped": 5, "lost": 0}
    received = stopped.handle_all()
    run.run_core()
    assert received + stopped.handle_all() == [0, 1, 2, 3, 9, 10, 11]


def test_messages_are_dropped_down_to_a_number() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run, ALWAYS)
    publish(run, publisher, channel, CREDIT + 8)
    make_room(run, publisher, messages=CREDIT + 1)
    assert blocks_alive(publisher) == CREDIT + 1


def test_nothing_is_dropped_while_memory_is_enough() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run, ALWAYS)
    publish(run, publisher, channel, CREDIT + 8)
    make_room(run, publisher, CREDIT + 8, (CREDIT + 8) * block_bytes(SIZE))
    assert run.counts(0)["dropped"] == 0


def test_young_messages_are_not_dropped() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run, ALWAYS)
    publish(run, publisher, channel, CREDIT + 8)
    make_room(run, publisher, messages=0, before_ns=CREDIT + 2)
    assert run.counts(0)["dropped"] == 2


def test_message_that_somebody_has_keeps_its_place_in_all_queues() -> None:
    """Dropping it would cost one subscriber a message and bring the publisher nothing."""
    run = SimulatedRun()
    publisher, channel, (hoarder, _stopped) = connected(run, ALWAYS, ALWAYS)
    for value in range(CREDIT + 4):
        assert publisher.publish(channel, value, SIZE)
        run.run_core()
        taken = hoarder.take()
        assert taken is not None
        (hoarder.endpoint.done if value < CREDIT + 2 else hoarder.endpoint.release)(taken)
        run.run_core()
    make_room(run, publisher, messages=0)
    assert run.counts(1)["dropped"] == 2
    assert blocks_alive(publisher) == CREDIT + 2


def test_newest_message_that_waits_may_be_dropped_and_is_replaced_no_more() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, NEWEST)
    publish(run, publisher, channel, 2)
    make_room(run, publisher, messages=0)
    assert run.counts(0)["dropped"] == 1
    publish(run, publisher, channel, 1)
    subscriber.handle_all()
    run.run_core()
    assert len(subscriber.handle_all()) == 1
    run.run_core()
    assert run.counts(0) == {"routed": 3, "delivered": 2, "replaced": 0, "dropped": 1, "lost": 0}


def test_other_publishers_lose_nothing() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run, ALWAYS)
    other = run.start(3)
    other_channel = other.advertise()
    other.ready()
    run.run_core()
    publish(run, publisher, channel, CREDIT)
    publish(run, other, other_channel, 3)
    make_room(run, publisher, messages=0)
    assert run.counts(0)["dropped"] == 0
    assert blocks_alive(other) == 3


def test_core_that_is_behind_is_asked_only_once() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run, ALWAYS)
    publish(run, publisher, channel, CREDIT + 8)
    asked = [publisher.endpoint.make_room(CREDIT + 3, WORD_MAX, LATER) for _ in range(3)]
    assert asked == [True, False, False]
    run.restart_core()  # the next core finds the request in the ring
    run.run_core()
    assert run.counts(0)["dropped"] == 5
    assert publisher.endpoint.make_room(CREDIT + 1, WORD_MAX, LATER)
    run.run_core()
    assert run.counts(0)["dropped"] == 7


def test_record_that_is_handled_again_drops_nothing_more() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run, ALWAYS)
    publish(run, publisher, channel, CREDIT + 8)
    for _ in range(3):
        make_room(run, publisher, messages=CREDIT + 3)
        run.restart_core()
    assert run.counts(0)["dropped"] == 5
