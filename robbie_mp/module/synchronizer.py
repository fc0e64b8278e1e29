"""Gives a handler the messages of several topics that belong together by their stamps."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, overload

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.records import MessageHandling
from robbie_mp.messages import Message
from robbie_mp.messages.field_types import Nested
from robbie_mp.messages.message import fields_of
from robbie_mp.messages.stock.builtin_interfaces import Time
from robbie_mp.messages.stock.std_msgs import Header
from robbie_mp.module.envelope import MessageType
from robbie_mp.module.module import Module
from robbie_mp.module.stamp_matcher import MatchCounts, StampMatcher

A = TypeVar("A", bound=Message)
B = TypeVar("B", bound=Message)
C = TypeVar("C", bound=Message)
D = TypeVar("D", bound=Message)

MIN_INPUTS = 2
WARN_AFTER = 50
"""A warning is logged if one topic gets this number of messages without any set."""


class CannotSynchronize(RobbieError, ValueError):
    """Messages cannot be brought together as asked."""


@dataclass(frozen=True)
class Input(Generic[MessageType]):
    """One of the topics that a `Synchronizer` brings together.

    Args:
        message_type: the class of the messages.
        topic: the topic to subscribe to; '' for all topics.
        stamp_ns: returns the stamp of a message, in ns since the epoch. By default it is `header.stamp` if
            the type has a header, else the time at which the message was published.
        min_period_s: a time that the messages of this topic are always apart, at least. The sets do not
            depend on it, but they are delivered earlier if it is known.
    """

    message_type: type[MessageType]
    topic: str = ""
    stamp_ns: Callable[[MessageType], int] | None = None
    min_period_s: float = 0.0

    def __str__(self) -> str:
        return self.topic or self.message_type.__name__


class Synchronizer:
    """Subscribes to several topics, and calls a handler with messages that belong together by their stamps.

        class Colours(Module):
            def setup(self) -> None:
                self.pairs = Synchronizer(
                    self,
                    Input(LaserScan, "laser"),
                    Input(Image, "camera"),
                    handler=self.on_pair,
                    tolerance_s=0.02,
                )

            def on_pair(self, scan: LaserScan, image: Image) -> None:
                ...
                self.status = str(self.pairs)

    With a tolerance of 0, the stamps must be the same. Otherwise each set has the messages that are nearest
    to one another, at most `tolerance_s` apart; choose less than half the time between two messages. Each
    message is used at most once, and the sets come in the order of their stamps. What is delivered depends
    on the stamps, and not on which topic's messages arrive first, unless too many wait.

    A set is delivered when no nearer message can come: if the stamps differ, when the earlier topics have
    sent a message from after the set's. This may take a period of the slowest topic, or less with
    `min_period_s`. Then `envelope` is that of the message that made it certain.

    Messages that wait stay in shared memory, at most `max_waiting` of each topic; within the limits of a
    module that keeps arrays, further ones are copied. If the stamps go back by more than a second, as when a
    played log jumps or a simulation begins again, everything that waits is left over, and matching begins
    again. For smaller jumps, call `forget` in a handler of `TimeJump`. A restarted module begins again, too.

    Args:
        module: the module; create the synchronizer in its `setup()`.
        inputs: two or more topics, each as an `Input`, or as a message type for its messages on all topics.
        handler: called with a message of each input, in their order.
        tolerance_s: greatest time between two stamps of a set.
        max_waiting: most messages of each topic that wait for those of other topics; beyond that, the oldest
            is left over.
        handling: what to do when messages come faster than they are handled. With KEEP_ONLY_NEWEST, a
            handler that is too slow gets newer sets, but not every set that it has time for.

    Raises:
        CannotSynchronize: fewer than two inputs, or a limit that makes no sense; or stamps must be the same,
            but a type has none of its own.
        SubscribedTwice: the module already subscribes to one of the inputs.
    """

    @overload
    def __init__(
        self,
        module: Module,
        a: type[A] | Input[A],
        b: type[B] | Input[B],
        /,
        *,
        handler: Callable[[A, B], None],
        tolerance_s: float = 0.0,
        max_waiting: int = 10,
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
    ) -> None: ...
    @overload
    def __init__(
        self,
        module: Module,
        a: type[A] | Input[A],
        b: type[B] | Input[B],
        c: type[C] | Input[C],
        /,
        *,
        handler: Callable[[A, B, C], None],
        tolerance_s: float = 0.0,
        max_waiting: int = 10,
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
    ) -> None: ...
    @overload
    def __init__(
        self,
        module: Module,
        a: type[A] | Input[A],
        b: type[B] | Input[B],
        c: type[C] | Input[C],
        d: type[D] | Input[D],
        /,
        *,
        handler: Callable[[A, B, C, D], None],
        tolerance_s: float = 0.0,
        max_waiting: int = 10,
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
    ) -> None: ...
    @overload
    def __init__(
        self,
        module: Module,
        a: type[Message] | Input[Any],
        b: type[Message] | Input[Any],
        c: type[Message] | Input[Any],
        d: type[Message] | Input[Any],
        e: type[Message] | Input[Any],
        /,
        *inputs: type[Message] | Input[Any],
        handler: Callable[..., None],
        tolerance_s: float = 0.0,
        max_waiting: int = 10,
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
    ) -> None: ...
    def __init__(
        self,
        module: Module,
        *inputs: type[Message] | Input[Any],
        handler: Callable[..., None],
        tolerance_s: float = 0.0,
        max_waiting: int = 10,
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
    ) -> None:
        self._module = module
        self._log = logging.getLogger(module.name)
        self._inputs = [one if isinstance(one, Input) else Input(one) for one in inputs]
        self._handler = handler
        self._tolerance_s = tolerance_s
        self._check(max_waiting)
        self._without_set = [0] * len(inputs)
        """Messages of each topic since the last set."""
        self._matcher = StampMatcher(
            len(inputs),
            self._deliver,
            round(tolerance_s * 1e9),
            max_waiting,
            [round(one.min_period_s * 1e9) for one in self._inputs],
        )
        for number, one in enumerate(self._inputs):
            module.subscribe(one.message_type, self._handler_of(number, one), handling, topic=one.topic)

    def _check(self, max_waiting: int) -> None:
        if len(self._inputs) < MIN_INPUTS:
            raise CannotSynchronize(f"expected two or more inputs; got {len(self._inputs)}")
        if not 0 <= self._tolerance_s < float("inf"):
            raise CannotSynchronize(f"tolerance_s is {self._tolerance_s}; it must be at least 0, and finite")
        if max_waiting < 1:
            raise CannotSynchronize(f"max_waiting is {max_waiting}; it must be at least 1")
        for one in self._inputs:
            if one.min_period_s < 0:
                raise CannotSynchronize(f"{one}: min_period_s is {one.min_period_s}; it must be at least 0")
            if not self._tolerance_s and one.stamp_ns is None and _stamp_of(one.message_type) is None:
                raise CannotSynchronize(
                    f"{one.message_type.__name__} has no header.stamp, and no two messages are published at "
                    "exactly the same time; give a tolerance_s, or the stamp_ns of its Input"
                )

    def __str__(self) -> str:
        """Return a short text for a status line: sets, and what was left over of each topic."""
        counts = self._matcher.counts
        rest = ", ".join(f"{one} {count.left_over}" for one, count in zip(self._inputs, counts, strict=True))
        return f"{self.matched} sets; left over: {rest}"

    @property
    def matched(self) -> int:
        """The number of sets that the handler was called with."""
        return self._matcher.counts[0].matched

    @property
    def counts(self) -> list[MatchCounts]:
        """Counts of the messages of each input by their fate, in the order of the inputs."""
        return self._matcher.counts

    def forget(self) -> None:
        """Leave over everything that waits, and begin again; the next stamps may be earlier."""
        self._matcher.forget()

    def _handler_of(self, number: int, one: Input[Any]) -> Callable[[Any], None]:
        stamp_ns = one.stamp_ns or _stamp_of(one.message_type) or self._published_ns

        def add(message: Any) -> None:
            self._without_set[number] += 1
            self._matcher.add(number, stamp_ns(message), message)
            if self._without_set[number] == WARN_AFTER:
                self._warn(number)

        # Crash reports and `robbie top` name the author's handler.
        add.__qualname__ = getattr(self._handler, "__qualname__", type(self._handler).__qualname__)
        return add

    def _published_ns(self, _message: Message) -> int:
        """Return when the message being handled was published, in ns since the epoch."""
        clock = self._module.clock
        return clock.now_ns() - clock.monotonic_ns() + self._module.envelope.published_ns

    def _deliver(self, *messages: Message) -> None:
        self._without_set = [0] * len(self._inputs)
        self._handler(*messages)

    def _warn(self, number: int) -> None:
        """Say why the handler is not called."""
        others = zip(self._inputs, self._without_set, strict=True)
        silent = [str(one) for one, messages in others if not messages]
        nearest_ns = self._matcher.nearest_ns
        if silent:
            why = f"nothing came from {', '.join(silent)}"
        elif nearest_ns is not None:
            apart_s = nearest_ns / 1e9
            why = f"stamps were at least {apart_s:.6g} s apart; the tolerance is {self._tolerance_s:g} s"
        else:
            why = f"more than max_waiting had to wait; {self}"
        self._log.warning("%d messages of %s without a match: %s", WARN_AFTER, self._inputs[number], why)


def _stamp_of(message_type: type[Message]) -> Callable[[Any], int] | None:
    """Return what reads the stamp in the header of a type; None if it has none."""
    kinds = {field.name: field.type for field in fields_of(message_type)}
    kind = kinds.get("header")
    if isinstance(kind, Nested) and kind.message is Header:
        return _header_ns
    return None


def _header_ns(message: Any) -> int:
    stamp: Time = message.header.stamp
    return stamp.nanoseconds
