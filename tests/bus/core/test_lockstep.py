"""In lockstep the whole robot handles one message at a time, in one order, even if a process dies."""

from robbie_mp import MessageHandling
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import Inbound
from tests.bus.core._support.simulated_run import SimulatedModule, SimulatedRun, connected


def take_one(run: SimulatedRun, *modules: SimulatedModule) -> tuple[int, int]:
    """Let the one module that has a message handle it; return its slot and the value."""
    found = []
    for module in modules:
        delivery = module.take()
        if delivery is not None:
            found.append((module, delivery))
    ((module, delivery),) = found
    module.endpoint.release(delivery)
    return module.slot, delivery.stamp_ns


def test_one_module_has_one_message_at_a_time_and_the_first_in_the_profile_is_first() -> None:
    run = SimulatedRun(lockstep=True)
    publisher, channel, (first, second) = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
    for value in (1, 2):
        publisher.publish(channel, value)
    order = []
    for _ in range(4):
        run.run_core()
        assert not run.is_settled
        order.append(take_one(run, second, first))
    run.run_core()
    assert order == [(first.slot, 1), (second.slot, 1), (first.slot, 2), (second.slot, 2)]
    assert run.is_settled
    assert first.take() is second.take() is None


def test_what_a_handler_publishes_comes_after_what_waited_and_before_it_is_settled() -> None:
    run = SimulatedRun(lockstep=True)
    publisher, channel, (first, second) = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
    own = first.advertise("answers")
    publisher.publish(channel, 1)
    run.run_core()
    delivery = first.take()
    assert delivery is not None
    first.publish(own, 2)
    run.run_core()
    assert second.take() is None  # as long as the first has its message
    first.endpoint.release(delivery)
    order = []
    for _ in range(3):
        run.run_core()
        order.append(take_one(run, first, second))
    run.run_core()
    assert order == [(second.slot, 1), (first.slot, 2), (second.slot, 2)]
    assert run.is_settled


def test_who_waits_for_it_is_woken_when_all_is_settled_and_not_before() -> None:
    run = SimulatedRun(lockstep=True)
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 1)
    publisher.out[layout.OUT_AWAITS_SETTLED] = 1
    before = publisher.wakeups
    run.run_core()
    assert publisher.wakeups == before
    assert subscriber.core_wakeups is not None
    woken = subscriber.core_wakeups
    assert take_one(run, subscriber) == (subscriber.slot, 1)
    assert subscriber.core_wakeups > woken  # a release is never left for later
    run.run_core()
    assert publisher.wakeups > before


def test_release_is_told_at_once_though_notices_came_behind_the_message() -> None:
    run = SimulatedRun(lockstep=True)
    publisher, channel, (subscriber, other) = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
    for value in (1, 2):
        publisher.publish(channel, value)
    run.run_core()
    assert take_one(run, subscriber, other) == (subscriber.slot, 1)
    run.run_core()
    assert take_one(run, subscriber, other) == (other.slot, 1)
    run.run_core()
    run.router._members.notify(subscriber.slot, (Inbound.SEGMENTS_GONE, 9, 1, 0))
    run.run_core()
    woken = subscriber.core_wakeups
    assert take_one(run, subscriber) == (subscriber.slot, 2)
    assert subscriber.core_wakeups > woken


def test_module_that_not_even_sigkill_ends_is_not_waited_for() -> None:
    """It is given up: FAILED, but never reclaimed, for the kernel may still write into its memory."""
    run = SimulatedRun(lockstep=True)
    publisher, channel, (hung, other) = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
    publisher.publish(channel, 1)
    run.run_core()
    assert hung.take() is not None
    run.gone(hung, clean=False)
    assert take_one(run, other) == (other.slot, 1)
    run.restart_core()
    run.gone(hung, clean=False)  # the supervisor says it again
    publisher.publish(channel, 2)
    run.run_core()
    assert take_one(run, other) == (other.slot, 2)
    run.run_core()
    assert run.is_settled


def test_message_that_is_kept_counts_as_handled() -> None:
    run = SimulatedRun(lockstep=True)
    publisher, channel, (subscriber,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    publisher.publish(channel, 1)
    run.run_core()
    delivery = subscriber.take()
    assert delivery is not None
    subscriber.endpoint.done(delivery)
    run.run_core()
    assert run.is_settled


def test_restarting_module_is_waited_for_and_only_the_message_in_its_hands_is_lost() -> None:
    run = SimulatedRun(lockstep=True)
    publisher, channel, (first, second) = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
    for value in (1, 2):
        publisher.publish(channel, value)
    run.run_core()
    assert first.take() is not None
    run.kill(first)
    assert take_one(run, second) == (second.slot, 1)
    run.run_core()
    assert second.take() is None  # the message after it is the dead module's first
    assert not bool(run.is_settled)
    successor = run.start(first.slot, 2)
    successor.subscribe()
    successor.ready()
    run.run_core()
    assert take_one(run, successor, second) == (first.slot, 2)
    run.run_core()
    assert take_one(run, successor, second) == (second.slot, 2)
    run.run_core()
    assert run.is_settled
    assert run.counts(0)["lost"] == 1


def test_core_killed_at_any_store_goes_on_in_step() -> None:
    for deaths in range(1, 400, 3):
        run = SimulatedRun(lockstep=True)
        publisher, channel, (first, second) = connected(run, *[MessageHandling.ALWAYS_DELIVER] * 2)
        run.fuse.stores = 0
        run.fuse.deaths = [deaths]
        order = []
        for value in (1, 2):
            publisher.publish(channel, value)
        for _ in range(4):
            run.run_core()
            order.append(take_one(run, first, second))
        run.run_core()
        assert order == [(first.slot, 1), (second.slot, 1), (first.slot, 2), (second.slot, 2)]
        assert run.is_settled
        if not run.crashes:
            break
    else:
        raise AssertionError("the core did not live long enough in any case")


def test_newest_message_of_those_of_one_handler_is_kept() -> None:
    run = SimulatedRun(lockstep=True)
    publisher, channel, (busy, newest) = connected(
        run, MessageHandling.ALWAYS_DELIVER, MessageHandling.KEEP_ONLY_NEWEST
    )
    for value in (1, 2, 3):
        publisher.publish(channel, value)
    run.run_core()
    order = []
    for _ in range(4):
        order.append(take_one(run, busy, newest))
        run.run_core()
    assert order == [(busy.slot, 1), (busy.slot, 2), (busy.slot, 3), (newest.slot, 3)]


def charge(module: SimulatedModule, since_ns: int, charged_ns: int) -> None:
    """Show how long the module is busy by the run's clock, as it does before it releases a message."""
    module.out[layout.OUT_CHARGED_SINCE_NS] = since_ns
    module.out[layout.OUT_CHARGED_NS] = charged_ns


def test_busy_module_gets_the_newest_message_when_its_time_is_over() -> None:
    now_ns = 0
    run = SimulatedRun(lockstep=True, charged_ns=lambda: now_ns)
    kinds = MessageHandling.KEEP_ONLY_NEWEST, MessageHandling.ALWAYS_DELIVER
    publisher, channel, (slow, quick) = connected(run, *kinds)
    publisher.publish(channel, 1)
    run.run_core()
    delivery = slow.take()
    assert delivery is not None
    charge(slow, 0, 100)
    slow.endpoint.release(delivery)
    run.run_core()
    assert take_one(run, slow, quick) == (quick.slot, 1)
    for value, now_ns in ((2, 30), (3, 60), (4, 99)):  # noqa: B007
        publisher.publish(channel, value)
        run.run_core()
        assert take_one(run, slow, quick) == (quick.slot, value)
        run.run_core()
        assert run.is_settled, "time must be able to go on"
        assert slow.take() is None
    now_ns = 100
    publisher.publish(channel, 5)
    run.run_core()
    assert not run.is_settled
    assert take_one(run, slow, quick) == (slow.slot, 5)
    run.run_core()
    assert take_one(run, slow, quick) == (quick.slot, 5)
    run.run_core()
    assert run.is_settled


def test_module_is_not_busy_when_time_has_been_set_back() -> None:
    now_ns = 1000
    run = SimulatedRun(lockstep=True, charged_ns=lambda: now_ns)
    publisher, channel, (slow,) = connected(run, MessageHandling.ALWAYS_DELIVER)
    charge(slow, 1000, 100)
    publisher.publish(channel, 1)
    run.run_core()
    assert slow.take() is None and run.is_settled
    now_ns = 500
    publisher.publish(channel, 2)
    run.run_core()
    assert take_one(run, slow) == (slow.slot, 1)
