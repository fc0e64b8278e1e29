"""Publishers that wait for blocks or credit: a release wakes the core, and the core wakes the publisher."""

from robbie_mp import MessageHandling
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Outbound
from tests.bus.core._support.simulated_run import CREDIT, SimulatedModule, SimulatedRun, connected


def test_publisher_is_refused_when_its_ring_is_full_but_can_still_release() -> None:
    run = SimulatedRun()
    publisher, channel, _ = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.subscribe(type_name="test_msgs/msg/Other")
    run.run_core()
    while publisher.publish(channel, 1):
        pass
    publisher.endpoint.send(Outbound.WAIT_FREED, 1)
    run.run_core()
    assert publisher.publish(channel, 2)


def test_releases_that_would_else_wake_nobody_wake_the_core_while_a_publisher_waits() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 1)
    run.run_core()
    assert subscriber.into[layout.IN_WANT_RELEASE] == 0
    publisher.endpoint.wake_after_freed(1)
    run.run_core()
    assert subscriber.into[layout.IN_WANT_RELEASE] == 1


def test_module_with_much_to_handle_wakes_the_core_when_half_of_it_is_taken() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(3 * CREDIT):
        publisher.publish(channel, value)
        run.run_core()
    posts = []
    while (delivery := subscriber.take()) is not None:
        before = subscriber.core_wakeups
        subscriber.endpoint.release(delivery)
        posts.append(subscriber.core_wakeups - before)
    assert posts == [0] * (CREDIT // 2 - 1) + [1] * (CREDIT // 2 + 1)


def wakes_the_publisher(run: SimulatedRun, publisher: SimulatedModule, subscriber: SimulatedModule) -> bool:
    before = publisher.wakeups
    subscriber.handle_all()
    run.run_core()
    return publisher.wakeups > before


def test_waiting_publisher_is_woken_when_so_many_blocks_have_been_freed() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(2):
        publisher.publish(channel, value)
    publisher.endpoint.wake_after_freed(3)
    run.run_core()
    assert not wakes_the_publisher(run, publisher, subscriber)
    publisher.publish(channel, 2)
    run.run_core()
    assert wakes_the_publisher(run, publisher, subscriber)


def test_blocks_freed_before_the_core_hears_that_they_are_waited_for_count() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    for value in range(3):
        publisher.publish(channel, value)
    run.run_core()
    subscriber.handle_all()
    run.run_core()
    before = publisher.wakeups
    publisher.endpoint.wake_after_freed(3)
    run.run_core()
    assert publisher.wakeups > before


def test_publisher_waits_on_when_the_core_dies() -> None:
    run = SimulatedRun()
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 1)
    publisher.endpoint.wake_after_freed(1)
    run.run_core()
    run.restart_core()
    assert subscriber.into[layout.IN_WANT_RELEASE] == 1
    assert wakes_the_publisher(run, publisher, subscriber)


def test_refused_messages_wake_a_waiting_publisher_too() -> None:
    run = SimulatedRun(handles=1)
    publisher, channel, (_subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 1)
    publisher.publish(channel, 2)
    publisher.endpoint.wake_after_freed(1)
    before = publisher.wakeups
    run.run_core()
    assert publisher.wakeups > before
