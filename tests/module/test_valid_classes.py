"""What looks like a mistake in a class of modules and is none is not refused."""

import functools
from collections.abc import Callable
from threading import Thread
from typing import Any

import pytest

from robbie_mp import Module, ModuleHarness, setting
from robbie_mp.messages import LaserScan


def plain(message: LaserScan) -> None:
    pass


class InnerClass(Module):
    class Worker(Thread):
        def publish(self, topic: str, number: int) -> None: ...

        def run(self) -> None:
            self.publish("scan", 3)


class InnerSelf(Module):
    def setup(self) -> None:
        def every(self: Any) -> None:
            self.every()

        self.later = every


class SetWithAType(Module):
    def setup(self) -> None:
        self.handler: Callable[[LaserScan], None] = plain
        self.subscribe(LaserScan, self.handler)


class SetTogether(Module):
    def setup(self) -> None:
        self.handler, self.number = plain, 1
        self.subscribe(LaserScan, self.handler)


class Placeholder(Module):
    handler: Any = None

    def setup(self) -> None:
        self.handler = plain
        self.subscribe(LaserScan, self.handler)


class SetByName(Module):
    period_s = 0.0

    def setup(self) -> None:
        setattr(self, "handler", plain)  # noqa: B010
        setattr(self, "period_s", 0.1)  # noqa: B010
        self.subscribe(LaserScan, self.handler)  # type: ignore[attr-defined]

    def tick(self) -> None: ...


class PeriodOfTimer(Module):
    period_s: float = setting(0.1, "time between looks")

    def setup(self) -> None:
        self.every(self.period_s, print)


class TickSetInSetup(Module):
    period_s = 0.1

    def setup(self) -> None:
        self.tick = functools.partial(print, "tick")  # type: ignore[method-assign]


class AnyName(Module):
    def __getattr__(self, name: str) -> Any:
        if name != "handler":
            raise AttributeError(name)
        return plain

    def setup(self) -> None:
        self.subscribe(LaserScan, self.handler)


class Partial(Module):
    period_s = 0.1

    def ticks(self, number: int) -> None: ...

    tick = functools.partialmethod(ticks, 3)

    def on_any(self, scan: LaserScan, number: int) -> None: ...

    on_scan = functools.partialmethod(on_any, number=3)

    def setup(self) -> None:
        self.subscribe(LaserScan, self.on_scan)


class Property(Module):
    @property
    def handler(self) -> Callable[[LaserScan], None]:
        return plain

    def setup(self) -> None:
        self.subscribe(LaserScan, self.handler)


def decorated(function: Callable[..., None]) -> Callable[..., None]:
    @functools.wraps(function)
    def wrapper(*arguments: Any) -> None:
        function(*arguments)

    return wrapper


class DecoratedConstructor(Module):
    @decorated
    def __init__(self, context: Any):
        super().__init__(context)


def made_here(*, other: bool) -> type[Module]:
    if other:

        class Node(Module):
            def setup(self) -> None:
                self.subscribe(LaserScan, self.on_a)

            def on_a(self, scan: LaserScan) -> None: ...

    else:

        class Node(Module):  # type: ignore[no-redef]
            def setup(self) -> None:
                self.subscribe(LaserScan, self.on_b)

            def on_b(self, scan: LaserScan) -> None: ...

    return Node


class House(Module):
    period_s = 0.1


class OnlyListens(House):
    def setup(self) -> None:
        self.subscribe(LaserScan, plain)


class InnerConstructor(Module):
    class Worker(Thread):
        def __init__(self) -> None:
            super().__init__()

    def __init__(self, context: Any) -> None:
        super().__init__(context)
        self.worker = self.Worker()


class Rate:
    def set_rate(self, rate_hz: float) -> None:
        self.period_s = 1 / rate_hz


class MixinBehind(Module, Rate):
    def setup(self) -> None:
        self.set_rate(10.0)

    def tick(self) -> None: ...


def slow_down(module: Module) -> None:
    module.period_s = 0.5


class SetByAHelper(Module):
    def setup(self) -> None:
        slow_down(self)

    def tick(self) -> None: ...


class PeriodInTheBody(Module):
    period_s = 0.1
    rate_hz = 1 / period_s


class OwnName(Module):
    def setup(self) -> None:
        self.call = None  # type: ignore[assignment]


@pytest.mark.parametrize(
    "module",
    [
        OnlyListens, InnerConstructor, MixinBehind, SetByAHelper, PeriodInTheBody, OwnName,
        InnerClass, InnerSelf, SetWithAType, SetTogether, Placeholder, SetByName, PeriodOfTimer,
        TickSetInSetup, AnyName, Partial, Property,
        DecoratedConstructor, made_here(other=True), made_here(other=False),
    ],
)  # fmt: skip
def test_valid_class_is_not_refused(module: type[Module]) -> None:
    with ModuleHarness(module):
        pass


def test_name_of_a_stock_message_is_no_attribute() -> None:
    import robbie_mp  # noqa: PLC0415

    assert not hasattr(robbie_mp, "LaserScan")


def test_time_that_a_sum_of_floats_leaves_is_none() -> None:
    with ModuleHarness(Module) as harness:
        harness.advance(0.3 - 0.1 * 3)
