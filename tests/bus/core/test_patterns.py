"""Subscriptions by shell patterns: matched once for each channel, and still one message once for a module."""

from fnmatch import fnmatchcase
from functools import partial

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robbie_mp import MessageHandling
from robbie_mp.bus.core.directory import Directory, Subscription
from robbie_mp.bus.core.router import SlotLimits
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.endpoint import TooManyDeclarations
from robbie_mp.bus.transport.records import ANY_VERSION, Outbound
from tests.bus.core._support.history import History
from tests.bus.core._support.simulated_run import CREDIT, SimulatedModule, SimulatedRun
from tests.bus.core.test_crash_points import both_dead, fan_out, full_table, subscriber_dead

POSE = "test_msgs/msg/Pose"


def listening(run: SimulatedRun, *patterns: str, slot: int = 2, incarnation: int = 1) -> SimulatedModule:
    module = run.start(slot, incarnation)
    for pattern in patterns:
        module.subscribe_by_patterns(*pattern.split(" "))
    module.ready()
    run.run_core()
    return module


def publishing(run: SimulatedRun) -> SimulatedModule:
    module = run.start(1)
    module.ready()
    return module


def test_first_message_of_a_channel_opened_later_comes() -> None:
    run = SimulatedRun()
    logger = listening(run, "*")
    publisher = publishing(run)
    for value, topic in enumerate(("left", "right", "")):
        assert publisher.publish(publisher.advertise(topic, POSE), value)
    run.run_core()
    assert logger.handle_all() == [0, 1, 2]


def test_channel_opened_before_and_any_version_match_too() -> None:
    run = SimulatedRun()
    publisher = publishing(run)
    channel = publisher.endpoint.advertise(POSE, 7, "left")
    run.run_core()
    logger = listening(run, "test_msgs/*/P?se l*")
    other = listening(run, "test_msgs/*/P?se r*", slot=3)
    publisher.publish(channel, 1)
    run.run_core()
    assert (logger.handle_all(), other.handle_all()) == ([1], [])


def test_empty_topic_is_a_pattern_for_messages_without_a_topic() -> None:
    run = SimulatedRun()
    logger = listening(run, "* ")
    publisher = publishing(run)
    publisher.publish(publisher.advertise("left"), 1)
    publisher.publish(publisher.advertise(""), 2)
    run.run_core()
    assert logger.handle_all() == [2]


def test_message_that_several_patterns_match_comes_once_to_the_first() -> None:
    run = SimulatedRun()
    logger = run.start(2)
    numbers = [logger.subscribe_by_patterns(pattern) for pattern in ("*Pose", "*", "test_msgs/*")]
    logger.ready()
    publisher = publishing(run)
    for value, type_name in enumerate(("test_msgs/msg/Number", POSE)):
        publisher.publish(publisher.advertise(type_name=type_name), value)
    run.run_core()
    came = []
    while (delivery := logger.take()) is not None:
        came.append((delivery.declaration, delivery.stamp_ns))
        logger.endpoint.release(delivery)
    assert came == [(numbers[1], 0), (numbers[0], 1)]


def test_type_and_pattern_of_one_module_both_get_a_message() -> None:
    run = SimulatedRun()
    logger = run.start(2)
    logger.subscribe()
    logger.subscribe_by_patterns("*")
    logger.ready()
    publisher = publishing(run)
    publisher.publish(publisher.advertise(), 1)
    run.run_core()
    assert logger.handle_all() == [1, 1]


def test_who_asks_for_a_type_is_sent_a_message_before_who_asks_by_patterns() -> None:
    run = SimulatedRun()
    logger = listening(run, "*", slot=2)
    publisher = publishing(run)
    channel = publisher.advertise()
    run.run_core()
    user = run.start(3)
    user.subscribe()
    user.ready()
    run.run_core()
    order: list[str] = []
    for name, module in (("logger", logger), ("user", user)):
        vars(module)["wake"] = partial(order.append, name)
    for link in run.router._members.links:
        link.wake = run.modules[link.slot, link.incarnation].wake
    publisher.publish(channel, 1)
    run.run_core()
    assert order == ["user", "logger"]


def test_pattern_takes_over_from_one_that_the_next_incarnation_does_not_want() -> None:
    run = SimulatedRun()
    publisher = publishing(run)
    channel = publisher.advertise()
    first = listening(run, "*", "test_msgs/*")
    publisher.publish(channel, 1)
    run.run_core()
    assert first.handle_all() == [1]
    run.kill(first)
    second = listening(run, "test_msgs/*", incarnation=2)
    publisher.publish(channel, 2)
    run.run_core()
    assert second.handle_all() == [2]


def test_messages_wait_for_the_next_incarnation_and_for_the_next_core() -> None:
    run = SimulatedRun()
    publisher = publishing(run)
    channel = publisher.advertise()
    run.kill(listening(run, "*Number l*", "*"))
    publisher.publish(channel, 1)
    run.run_core()
    run.restart_core()
    publisher.publish(publisher.advertise("left"), 2)
    second = listening(run, "*Number l*", "*", incarnation=2)
    assert second.handle_all() == [1, 2]


@pytest.mark.slow
@pytest.mark.parametrize("scenario", (fan_out, full_table, subscriber_dead, both_dead))
def test_core_may_die_before_any_store_and_patterns_stay(scenario: object) -> None:
    def play(deaths: tuple[int, ...]) -> History:
        history = History(deaths, handles=12, by_patterns=True)
        scenario(history)  # type: ignore[operator]
        history.finish()
        assert history.run.counts(2)["routed"] == 0, "a message came for both patterns"
        return history

    for death in range(0, play(()).run.fuse.stores, 2):
        assert play((death,)).run.crashes == 1


TOOLS = (2, 3)


def reuse_of_rows(deaths: tuple[int, ...]) -> SimulatedRun:
    """A tool's second pattern gets a row before its first one, where another tool has left."""
    run = SimulatedRun(handles=16)
    tools = [SlotLimits(20, 1 << 20, CREDIT, is_tool=True)] * 2
    run.limits = [*run.limits[:2], *tools, run.limits[-1]]
    run.restart_core()
    publisher = publishing(run)
    channel = publisher.advertise()
    left = listening(run, "*", slot=2)
    tool = listening(run, "test_msgs/*", slot=3)
    run.kill(left)
    run.gone(left, clean=True)
    tool.subscribe_by_patterns("*")
    run.run_core()
    run.fuse.stores, run.fuse.deaths = 0, list(deaths)
    came = []
    for value in range(4):
        publisher.publish(channel, value)
        run.run_core()
        came += tool.handle_all()
    run.run_core()
    assert came == [0, 1, 2, 3]
    assert sum(run.counts(row)["routed"] for row in range(2)) == 4
    return run


def test_message_comes_once_though_another_pattern_is_first_after_a_crash() -> None:
    for death in range(reuse_of_rows(()).fuse.stores):
        assert reuse_of_rows((death,)).crashes == 1


def test_message_would_come_twice_if_the_new_core_asked_one_pattern_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def the_first(_directory: Directory, entry: Subscription, _channel: object) -> list[Subscription]:
        return [entry]

    stores = reuse_of_rows(()).fuse.stores
    monkeypatch.setattr(Directory, "alternatives", the_first)
    with pytest.raises(AssertionError):
        for death in range(stores):
            reuse_of_rows((death,))


HOSTILE = st.text("*?[]!-^\\&|~(){}.$ab\n\0é/", min_size=1, max_size=48)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(HOSTILE, HOSTILE), max_size=4))
@example([("*a" * 47 + "*b", "*"), ("*" + "?*" * 47, "*" + "[!a]" * 23), ("[" + "a-b" * 31 + "]", "[[][[")])
def test_any_pattern_matches_as_in_a_shell_and_faults_nobody(patterns: list[tuple[str, str]]) -> None:
    run = SimulatedRun()
    logger = run.start(2)
    for type_pattern, topic_pattern in patterns:
        logger.subscribe_by_patterns(type_pattern, topic_pattern)
    logger.ready()
    publisher = publishing(run)
    topics = ["a" * layout.NAME_BYTES, "ab[", ""]
    for value, topic in enumerate(topics):
        publisher.publish(publisher.advertise(topic, topic or POSE), value)
    run.restart_core()
    expected = [
        value
        for value, topic in enumerate(topics)
        if any(fnmatchcase(topic or POSE, one) and fnmatchcase(topic, two) for one, two in patterns)
    ]
    assert logger.handle_all() == expected
    assert run.reports == []


def test_module_has_few_patterns_and_is_faulted_for_more() -> None:
    run = SimulatedRun(subscriptions=4 * layout.MAX_PATTERNS)
    listening(run, *(f"*{number}" for number in range(layout.MAX_PATTERNS)), slot=3)
    assert run.reports == []
    module = run.start(2)
    for number in range(layout.MAX_PATTERNS):
        module.subscribe_by_patterns(f"*{number}")
    with pytest.raises(TooManyDeclarations, match="one pattern replace several"):
        module.subscribe_by_patterns("*")
    handling = MessageHandling.ALWAYS_DELIVER
    number = module.endpoint._declare(Outbound.SUBSCRIBE, "*", ANY_VERSION, "*", handling)
    module.endpoint.send(Outbound.SUBSCRIBE, number)
    for _ in range(4):  # its ring is small
        run.run_core()
        assert module.take() is None
    run.run_core()
    assert "at most 32 patterns" in " ".join(run.reports)
