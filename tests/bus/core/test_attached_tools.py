"""Attached tools in the core: a smaller credit, and rows that are used again, whenever the core dies."""

from collections.abc import Iterator

import pytest

from robbie_mp.bus.core.router import SlotLimits
from robbie_mp.bus.transport import layout
from tests.bus.core._support.simulated_run import SimulatedModule, SimulatedRun

PUBLISHER, LISTENER, TOOL = 1, 2, 3
TOOL_CREDIT = 2


class Watched:
    """A publisher, a module that listens, and a place for tools."""

    def __init__(self, deaths: tuple[int, ...] = ()):
        self.run = SimulatedRun(queue_messages=5, handles=16)
        self.run.limits[TOOL] = SlotLimits(3, 1 << 20, TOOL_CREDIT, is_tool=True)
        self.run.restart_core()
        self.run.fuse.stores = 0
        self.run.fuse.deaths = list(deaths)
        self.listener = self.run.start(LISTENER)
        self.listener.subscribe()
        self.listener.ready()
        self.publisher = self.run.start(PUBLISHER)
        self.channel = self.publisher.advertise(topic="left")
        self.publisher.ready()
        self.run.run_core()
        self.seen: list[int] = []
        self.published = 0
        self.tools = 0

    def attach(self, topic: str = "") -> SimulatedModule:
        self.tools += 1
        tool = self.run.start(TOOL, self.tools)
        tool.subscribe(topic=topic)
        tool.ready()
        self.run.run_core()
        return tool

    def detach(self, tool: SimulatedModule) -> None:
        self.run.kill(tool)
        self.run.gone(tool, clean=True)

    def publish(self, times: int) -> None:
        for _ in range(times):
            self.published += 1
            assert self.publisher.publish(self.channel, self.published)
            self.run.run_core()
            self.seen += self.listener.handle_all()
            self.run.run_core()

    def check(self) -> None:
        """The module has missed nothing, and nothing is left of the tools."""
        assert self.seen == list(range(1, self.published + 1))
        assert self.run.reports == []
        assert self.run.live_handles() == self.run.live_references() == 0
        self.publisher.collect_freed()
        assert not self.publisher.blocks_out
        counts = self.run.counts(0)
        assert counts["routed"] == counts["delivered"] == self.published

    def open_rows(self) -> Iterator[int]:
        for index in range(self.run.tables.sizes.subscriptions):
            if self.run.words[self.run.tables.subscription(index)]:
                yield index


def tools_come_and_go(watched: Watched) -> None:
    first = watched.attach()
    watched.publish(2)
    got = first.handle_all()
    watched.publish(7)  # more than it may have and more than may wait
    in_hand = first.take()
    assert in_hand is not None
    watched.detach(first)  # killed while it handles a message
    watched.publish(1)
    second = watched.attach(topic="left")
    watched.publish(1)
    got += second.handle_all()
    watched.run.run_core()
    assert got == [1, 2, 11]
    assert watched.run.counts(1) == {"routed": 1, "delivered": 1, "replaced": 0, "dropped": 0, "lost": 0}
    watched.detach(second)
    watched.check()
    assert list(watched.open_rows()) == [0, 1]


@pytest.mark.slow
def test_core_may_die_before_any_store_while_tools_come_and_go() -> None:
    undisturbed = Watched()
    tools_come_and_go(undisturbed)
    stores = undisturbed.run.fuse.stores
    assert stores > 200
    for death in range(stores):
        watched = Watched((death,))
        tools_come_and_go(watched)
        assert watched.run.crashes == 1
    for first in range(0, stores, 29):
        tools_come_and_go(Watched((first, first % 13)))


def test_tool_that_stands_still_holds_what_its_credit_and_queue_allow() -> None:
    watched = Watched()
    tool = watched.attach()
    watched.publish(20)
    assert watched.run.live_handles() == TOOL_CREDIT + 3
    assert watched.run.counts(1) == {"routed": 20, "delivered": 0, "replaced": 0, "dropped": 15, "lost": 0}
    watched.detach(tool)
    watched.check()


def test_a_thousand_tools_use_one_row() -> None:
    watched = Watched()
    for number in range(1000):
        watched.detach(watched.attach(topic=f"topic {number}"))
    watched.publish(1)
    watched.check()
    assert list(watched.open_rows()) == [0, 1]


def test_row_of_a_module_is_not_used_again() -> None:
    watched = Watched()
    watched.publish(3)
    watched.run.kill(watched.listener)
    watched.run.gone(watched.listener, clean=True)
    watched.attach()
    assert watched.run.counts(0)["delivered"] == 3
    assert watched.run.words[watched.run.tables.subscription(1) + layout.SUBSCRIPTION_SLOT] == TOOL


def test_tool_is_faulted_when_the_table_is_full() -> None:
    watched = Watched()
    rows = watched.run.tables.sizes.subscriptions
    for number in range(rows - 1):
        watched.listener.subscribe(topic=f"topic {number}")
        watched.run.run_core()
    watched.attach()
    assert "no room for a subscription" in watched.run.reports[0]
    watched.publish(1)
    assert watched.seen == [1]


def test_tools_leave_a_quarter_of_the_channels_to_modules() -> None:
    watched = Watched()
    channels = watched.run.tables.sizes.channels
    tool = watched.attach()
    for number in range(channels):
        tool.advertise(topic=f"topic {number}")
    watched.run.run_core()
    assert "no room for channel" in watched.run.reports[0]
    watched.run.restart_core()
    for number in range(channels // 4):
        watched.publisher.advertise(topic=f"mine {number}")
    watched.publish(1)
    assert watched.seen == [1]
    assert all("in slot 3" in report for report in watched.run.reports), watched.run.reports
