"""Latched channels: a late subscriber gets the newest message first, and once, whatever dies."""

import pytest

from robbie_mp import MessageHandling
from robbie_mp.bus.core.router import SlotLimits
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.records import ANY_VERSION, Outbound
from robbie_mp.bus.transport.words import WORD_MAX
from tests.bus.core._support.simulated_run import SimulatedModule, SimulatedRun

NEWEST = MessageHandling.KEEP_ONLY_NEWEST
LATE = 3


def publisher_of(run: SimulatedRun, *topics: str, slot: int = 1) -> tuple[SimulatedModule, list[int]]:
    publisher = run.start(slot)
    channels = [publisher.advertise(topic, is_latched=True) for topic in topics]
    publisher.ready()
    run.run_core()
    return publisher, channels


def subscribed(
    run: SimulatedRun,
    *topics: str,
    handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
    slot: int = LATE,
    incarnation: int = 1,
) -> SimulatedModule:
    module = run.start(slot, incarnation)
    for topic in topics:
        module.subscribe(handling, topic)
    module.ready()
    run.run_core()
    return module


def publish(run: SimulatedRun, publisher: SimulatedModule, channel: int, *values: int, size: int = 8) -> None:
    for value in values:
        assert publisher.publish(channel, value, size)
        run.run_core()


def latch_counts(run: SimulatedRun) -> dict[str, int]:
    """The books of the first latched channel of a run."""
    tables = run.tables
    for index in range(tables.sizes.subscriptions):
        at = tables.subscription(index)
        if run.words[at] and run.words[at + layout.SUBSCRIPTION_SLOT] == tables.sizes.slots - 1:
            return run.counts(index)
    raise AssertionError("no channel is latched")


@pytest.mark.slow
@pytest.mark.every_turn
def test_late_subscriber_gets_the_newest_message_once() -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1, 2, 3)
    late = subscribed(run, "map")
    assert late.handle_all() == [3]
    publish(run, publisher, channel, 4)
    assert late.handle_all() == [4]
    assert latch_counts(run) == {"routed": 4, "delivered": 0, "replaced": 3, "dropped": 0, "lost": 0}


def test_channel_that_is_not_latched_gives_nothing() -> None:
    run = SimulatedRun()
    publisher = run.start(1)
    channel = publisher.advertise("map")
    publisher.ready()
    publish(run, publisher, channel, 1)
    assert subscribed(run, "map").handle_all() == []


def test_latched_channel_without_topic_keeps_none_of_other_topics() -> None:
    run = SimulatedRun()
    publisher, [plain] = publisher_of(run, "")
    other = publisher.advertise("other")
    publish(run, publisher, plain, 1)
    publish(run, publisher, other, 2)
    assert subscribed(run, "").handle_all() == [1]


def test_channel_that_becomes_latched_keeps_what_comes_then() -> None:
    run = SimulatedRun()
    publisher = run.start(1)
    channel = publisher.advertise("map")
    publisher.ready()
    publish(run, publisher, channel, 1)
    latched = publisher.advertise("map", is_latched=True)
    publish(run, publisher, latched, 2)
    publish(run, publisher, channel, 3)
    assert subscribed(run, "map").handle_all() == [3]


def test_message_outlives_its_publisher() -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1)
    run.kill(publisher)
    run.restart_core()
    late = subscribed(run, "map")
    assert late.handle_all() == [1]
    assert run.live_handles() == 1


def test_restarted_subscriber_gets_it_again_and_what_waits_only_once() -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1)
    first = subscribed(run, "map")
    assert first.handle_all() == [1]
    run.kill(first)
    second = subscribed(run, "map", incarnation=2)
    assert second.handle_all() == [1]
    run.kill(second)
    publish(run, publisher, channel, 2)
    assert subscribed(run, "map", incarnation=3).handle_all() == [2]


def test_subscription_made_after_ready_gets_it_too() -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1)
    late = subscribed(run)
    late.subscribe(topic="map")
    run.run_core()
    assert late.handle_all() == [1]


def test_several_come_in_the_order_of_publishing_before_what_is_published_later() -> None:
    run = SimulatedRun()
    publisher, channels = publisher_of(run, "c", "a", "b")
    for value, channel in enumerate(channels):
        publish(run, publisher, channel, value)
    late = run.start(LATE)
    late.subscribe(topic="b")
    late.subscribe(topic="")
    run.run_core()
    publish(run, publisher, channels[0], 3)
    late.ready()
    run.run_core()
    assert late.handle_all() == [1, 2, 2, 3]


def test_newest_only_on_all_topics_gets_the_newest_of_all() -> None:
    run = SimulatedRun()
    publisher, channels = publisher_of(run, "a", "b")
    publish(run, publisher, channels[1], 1)
    publish(run, publisher, channels[0], 2)
    assert subscribed(run, "", handling=NEWEST).handle_all() == [2]


@pytest.mark.parametrize("patterns", [("test_msgs/*",), ("test_msgs/*", "*"), ("nothing/*", "*")])
def test_patterns_get_it_once(patterns: tuple[str, ...]) -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1)
    late = run.start(LATE)
    for pattern in patterns:
        late.subscribe_by_patterns(pattern)
    late.ready()
    run.run_core()
    assert late.handle_all() == [1]


def test_pattern_that_takes_over_from_one_not_declared_again_gets_it() -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    first = run.start(LATE)
    first.subscribe_by_patterns("test_msgs/*")
    first.ready()
    publish(run, publisher, channel, 1)
    assert first.handle_all() == [1]
    run.kill(first)
    second = run.start(LATE, 2)
    second.subscribe_by_patterns("*")
    second.ready()
    run.run_core()
    assert second.handle_all() == [1]


def test_full_queue_drops_other_messages_first() -> None:
    run = SimulatedRun(queue_messages=3)
    publisher, [channel] = publisher_of(run, "map")
    other = publisher.advertise("other")
    publish(run, publisher, channel, 1)
    first = subscribed(run, "map", "other")
    assert first.handle_all() == [1]
    run.kill(first)
    publish(run, publisher, other, *range(2, 8))
    assert subscribed(run, "map", "other", incarnation=2).handle_all() == [1, 5, 6, 7]


def test_core_keeps_no_more_messages_or_bytes_than_the_profile_allows() -> None:
    for run in (SimulatedRun(latched_messages=2), SimulatedRun(latched_bytes=200)):
        publisher, channels = publisher_of(run, "a", "b", "c")
        for value, channel in enumerate(channels):
            publish(run, publisher, channel, value, size=100)
        assert subscribed(run, "").handle_all() == [1, 2]
        assert latch_counts(run)["dropped"] == 1


def test_single_message_may_be_larger_than_the_limit() -> None:
    run = SimulatedRun(latched_bytes=10)
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1, 2, size=100)
    assert subscribed(run, "map").handle_all() == [2]


def test_without_a_free_reference_a_subscriber_misses_it_and_that_is_counted() -> None:
    run = SimulatedRun(references=2)
    publisher, channels = publisher_of(run, "a", "b")
    for channel in channels:
        publish(run, publisher, channel, 1)
    assert subscribed(run, "").handle_all() == []
    assert run.words[layout.CORE_NOT_GIVEN] == 2
    assert run.reports == []


def test_tools_leave_rows_for_latched_channels_of_modules() -> None:
    run = SimulatedRun(subscriptions=4)
    run.limits[2] = SlotLimits(20, 1 << 20, 4, is_tool=True)
    run.restart_core()
    tool = run.start(2)
    for topic in ("a", "b", "c", "d"):
        tool.advertise(topic, is_latched=True)
    tool.ready()
    run.run_core()
    assert "no room to latch" in run.reports[0]
    publisher_of(run, "map")
    assert len(run.reports) == 1


def test_short_of_memory_drops_what_is_latched_last_and_only_if_that_helps() -> None:
    run = SimulatedRun()
    publisher, [large, small] = publisher_of(run, "large", "small")
    other = publisher.advertise("other")
    waits = run.start(2)
    waits.subscribe(topic="other")
    run.run_core()  # it is not ready, so its messages wait
    publish(run, publisher, small, 1)
    publish(run, publisher, large, 2, size=1000)
    publish(run, publisher, other, 3, size=1000)

    def make_room(latched_bytes: int) -> list[int]:
        publisher.endpoint.make_room(100, 0, 1000, latched_bytes)
        run.run_core()
        words, tables = run.words, run.tables
        rows = [tables.handle(row) for row in range(tables.sizes.handles)]
        return sorted(words[at + layout.HANDLE_STAMP_NS] for at in rows if words[at])

    assert make_room(WORD_MAX) == [1, 2]
    assert make_room(1200) == [1, 2]
    assert make_room(200) == [1]
    assert latch_counts(run)["dropped"] == 1


def test_room_is_not_made_if_dropping_what_is_latched_would_not_be_enough() -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    other = publisher.advertise("other")
    holder = subscribed(run, "other")
    publish(run, publisher, channel, 1)
    publish(run, publisher, other, 2, size=1000)
    held = holder.take()
    assert held is not None
    publisher.endpoint.make_room(100, 0, 1000, 500)
    run.run_core()
    assert subscribed(run, "map", slot=2).handle_all() == [1]


def test_dead_publisher_of_a_latched_message_costs_the_others_nothing() -> None:
    """While the message of a dead publisher is kept, messages are still routed in C."""
    if SimulatedRun.memory.native is None:
        pytest.skip("only C leaves records to Python")
    run = SimulatedRun()
    dead, [channel] = publisher_of(run, "map", slot=2)
    publish(run, dead, channel, 1)
    run.kill(dead)
    publisher, [own] = publisher_of(run, "pose")
    listener = subscribed(run, "pose")
    handled: list[int] = []
    router = run.router
    vars(router)["_handle_next"] = lambda *_: handled.append(1)
    for value in range(5):
        publish(run, publisher, own, value)
        assert listener.handle_all() == [value]
        run.run_core()
    assert handled == []


def test_hostile_latched_declarations_are_faulted() -> None:
    run = SimulatedRun()
    module = run.start(1)
    number = module.advertise("map", is_latched=True)
    at = layout.OUT_DECLARATIONS + number * layout.DECLARATION_WORDS
    module.out[at + layout.DECLARATION_VERSION] = ANY_VERSION
    module.out[at + layout.DECLARATION_HANDLING] = 7
    module.endpoint.send(Outbound.ADVERTISE, number)
    run.run_core()
    assert "handling 7" in run.reports[0]


def test_in_lockstep_the_core_is_not_waited_for() -> None:
    run = SimulatedRun(lockstep=True)
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1)
    settled = [run.is_settled]
    late = subscribed(run, "map")
    settled.append(run.is_settled)
    assert late.handle_all() == [1]
    run.run_core()
    assert [*settled, run.is_settled] == [True, False, True]


def die_over(run: SimulatedRun, module: SimulatedModule, value: int) -> None:
    taken = module.take()
    assert taken is not None and taken.stamp_ns == value
    run.kill(module)


@pytest.mark.parametrize("handling", MessageHandling)
def test_message_that_killed_its_handler_twice_is_not_given_again(handling: MessageHandling) -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1)
    for incarnation in (1, 2):
        die_over(run, subscribed(run, "map", handling=handling, incarnation=incarnation), 1)
        run.restart_core()
    assert not run.reports
    third = subscribed(run, "map", handling=handling, incarnation=3)
    assert third.handle_all() == []
    assert run.reports == [
        f"module in slot {LATE}, incarnation 3, no longer gets latched message 1 for its subscription to "
        "test_msgs/msg/Number on topic 'map': it died over it twice"
    ]
    assert subscribed(run, "map", slot=2).handle_all() == [1], "the others do get it"
    publish(run, publisher, channel, 2)
    assert third.handle_all() == [2]
    run.kill(third)
    assert subscribed(run, "map", handling=handling, incarnation=4).handle_all() == [2]


def test_deaths_over_several_messages_are_counted_for_each() -> None:
    run = SimulatedRun()
    publisher, channels = publisher_of(run, "a", "b", "c", "d")
    for value, channel in enumerate(channels, 1):
        publish(run, publisher, channel, value)
    for incarnation, value in enumerate((1, 1, 2, 2, 3, 3), 1):
        die_over(run, subscribed(run, "", incarnation=incarnation), value)
    assert subscribed(run, "", incarnation=7).handle_all() == [4]


def test_message_that_was_handled_before_its_module_died_is_given_again() -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    other = publisher.advertise("other")
    publish(run, publisher, channel, 1)
    for incarnation in (1, 2, 3):
        module = subscribed(run, "map", "other", incarnation=incarnation)
        assert module.handle_all() == [1]
        publish(run, publisher, other, 7)
        die_over(run, module, 7)
    assert subscribed(run, "map", "other", incarnation=4).handle_all() == [1]


def test_module_that_is_started_as_ordered_gets_everything_again() -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1)
    for incarnation in (1, 2):
        module = subscribed(run, "map", incarnation=incarnation)
        die_over(run, module, 1)
    run.gone(module, clean=False)
    assert subscribed(run, "map", incarnation=3).handle_all() == [1]


def test_module_that_subscribes_late_is_not_given_it_a_third_time_either() -> None:
    run = SimulatedRun()
    publisher, [channel] = publisher_of(run, "map")
    publish(run, publisher, channel, 1)
    for incarnation in (1, 2, 3):
        module = subscribed(run, incarnation=incarnation)
        module.subscribe(topic="map")
        run.run_core()
        if incarnation < 3:
            die_over(run, module, 1)
    assert module.handle_all() == []
