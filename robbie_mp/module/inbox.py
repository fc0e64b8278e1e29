"""Receives messages: decodes them in the publisher's memory, releases them when nothing refers to them."""

import time
import weakref
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus._hot.choice import Native
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.blocks import LEAD_BYTES
from robbie_mp.bus.transport.endpoint import Endpoint
from robbie_mp.bus.transport.histogram import WorkFigures
from robbie_mp.bus.transport.history import Event, OwnHistory
from robbie_mp.bus.transport.layout import Activity
from robbie_mp.bus.transport.records import Delivery, Inbound
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.bus.transport.views import SegmentViews
from robbie_mp.bus.transport.words import WORD_BYTES, WORD_MAX, Words, row_writer
from robbie_mp.module.pins import Pins
from robbie_mp.module.subscriptions import Subscription, Subscriptions
from robbie_mp.module.wiring import UNCHANGED, Wiring

# Looked up once, not for every message.
_HANDLER, _IDLE = int(Activity.HANDLER), int(Activity.IDLE)
_ACTIVITY = layout.OUT_ACTIVITY
_ACTIVITY_AT = layout.OUT_ACTIVITY_SINCE_NS * WORD_BYTES


class DamagedMessage(RobbieError, ValueError):
    """A handle does not point to a message of its type; the publisher's memory is damaged."""


class Inbox:
    """Takes messages one by one. Belongs to the module's main thread.

    Args:
        endpoint: the module's connection to the core.
        views: maps of the publishers' memory.
        words: the module's out segment, for the counters.
        channel_name: returns type, version and topic of a channel's messages.
        native: what is written in C, which endpoint and views use as well; None: Python does it.
        wiring: the names that the profile gives to the module's topics.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        views: SegmentViews,
        words: Words,
        channel_name: Callable[[int], ChannelName],
        native: Native | None = None,
        wiring: Wiring = UNCHANGED,
    ):
        self._endpoint = endpoint
        self._views = views
        self._words = words
        self._channel_name = channel_name
        self.subscriptions = Subscriptions(self._request, self.name_current, wiring)
        self.subscriptions.refusals.on_refused = self._show_refused
        self._by_number = self.subscriptions.by_number
        unreferenced: Any = deque() if native is None else native.Unreferenced()
        self._unreferenced: deque[int] = unreferenced
        """References to messages that nothing refers to any more; filled by finalizers, in any thread."""
        pins: Any = Pins(words) if native is None else native.Pins(words)
        self._pins: Pins = pins
        self._copied = 0
        self._write_activity = row_writer(words, 2)
        self._figures = WorkFigures(words, layout.OUT_MESSAGE_FIGURES)
        self._current: Delivery | None = None
        self.native: Any = None
        """Takes and handles what is of the common form; None, or its answer None: Python does it."""
        if native is not None:
            self.native = native.Subscriber(
                endpoint.native, words, views.mapped, self._by_number, unreferenced, pins, RobbieError
            )
        self._history: OwnHistory | None = None
        self.before_release: Callable[[], None] | None = None
        """Called when a message has been handled, before other processes can see that it was."""

    def record_into(self, history: OwnHistory) -> None:
        """Record from now on what is handled."""
        self._history = history
        if self.native is not None:
            self.native.record_into(history.writer)

    def _request(self, subscription: Subscription) -> int:
        handler = subscription.handler
        handler_name = getattr(handler, "__qualname__", type(handler).__qualname__)
        return self._endpoint.subscribe(
            *subscription.name,
            subscription.handling,
            handler_name,
            is_optional=subscription.is_optional,
            own_topic=subscription.own_topic,
        )

    @property
    def source(self) -> int | None:
        """The source of the message that is being handled; this takes less time than `current`."""
        if self._current is None and self.native is not None:
            source: int | None = self.native.source
            return source
        return None if self._current is None else self._current.source

    @property
    def current(self) -> Delivery | None:
        """The message that is being handled."""
        if self._current is None and self.native is not None:
            current: Delivery | None = self.native.current
            return current
        return self._current

    def newest_stamp_ns(self, subscribed: ChannelName) -> int:
        """Return when the newest message of a subscription was published, machine's clock; -1: none came."""
        return self._words[layout.newest_at(self.subscriptions.numbers[subscribed])] or -1

    def show_deadline(
        self, subscribed: ChannelName, deadline_ns: int, latenesses: int, greatest_age_ns: int
    ) -> None:
        """Show observers the deadline of a subscription, and how it is kept."""
        at = layout.newest_at(self.subscriptions.numbers[subscribed]) - layout.DECLARATION_NEWEST_NS
        self._words[at + layout.DECLARATION_DEADLINE_NS] = deadline_ns
        self._words[at + layout.DECLARATION_GREATEST_AGE_NS] = greatest_age_ns
        self._words[at + layout.DECLARATION_LATENESSES] = latenesses

    def handle_next(self) -> bool:
        """Take and handle the next message, in C if it is of the common form; False if there is none."""
        if self.native is not None and self.before_release is None:
            was_one: bool | None = self.native.handle_next(self)
            if was_one is not None:
                return was_one
        delivery = self.take()
        if delivery is not None:
            self.handle(delivery)
        return delivery is not None

    def take(self) -> Delivery | None:
        """Take the next message to handle; None if there is none."""
        if self._unreferenced:
            self.release_unreferenced()
        while (record := self._endpoint.take()) is not None:
            if isinstance(record, Delivery):
                return record
            if record.kind is Inbound.SEGMENTS_GONE:
                self._views.drop(record.slot, record.incarnation)
        return None

    def handle(self, delivery: Delivery) -> None:
        """Run the handler of a message; then release the message, or pin it while anything refers to it."""
        begun_ns = self.show(_HANDLER | delivery.declaration << 8)
        self._current = delivery
        newest_at = layout.newest_at(delivery.declaration)
        newest_before_ns, ill_formed_before = self._words[newest_at], self._words[layout.OUT_ILL_FORMED]
        self._words[newest_at] = delivery.stamp_ns
        is_lost = False
        _, _, decoder, handler, *_ = self._by_number[delivery.declaration]
        pin: weakref.ref[Any] | None = None
        whole: Any = None
        try:
            view = self._views.view(delivery.source, delivery.offset, delivery.size)
            if len(view) != delivery.size:
                raise DamagedMessage(
                    f"message {delivery.sequence} lies beyond the end of its publisher's memory"
                )
            if self._history is not None:
                self._history.append(
                    Event.MESSAGE, begun_ns, delivery.channel | delivery.declaration << 32,
                    delivery.sequence, delivery.source, delivery.stamp_ns, view,
                )  # fmt: skip
            if decoder.has_views and (not self._pins or self._may_pin(delivery)):
                whole = np.frombuffer(view, np.uint8)
                unreferenced, reference = self._unreferenced, delivery.reference
                pin = weakref.ref(whole, lambda _: unreferenced.append(reference))
                message = decoder.decode(whole.data)
                whole = None
            elif decoder.has_views:
                message = decoder.decode(self._copy(view))
            else:
                message = decoder.decode(view)
        except RobbieError as error:
            whole = None
            is_lost = True
            self.tell_lost(error)
        else:
            try:
                handler(message)
            except BaseException:
                pin = None  # nothing is pinned; in Python 3.14, the message may die before the weak reference
                raise
            del message
        self._current = None
        if is_lost or self._words[layout.OUT_ILL_FORMED] != ill_formed_before:
            self._words[newest_at] = newest_before_ns  # no handler got it
        self._words[layout.OUT_HANDLED] = self._words[layout.OUT_HANDLED] + 1 & WORD_MAX
        if self.before_release is not None:
            self.before_release()
        if pin is None or self._is_unreferenced(delivery.reference):
            self.release(delivery)
        else:
            self._pins.add(delivery, pin)
            self.done(delivery)
        self.show_idle()
        self._figures.record(begun_ns - delivery.stamp_ns, time.monotonic_ns() - begun_ns)

    def show(self, activity: int) -> int:
        """Show what the module does; return the time, in ns."""
        now_ns = time.monotonic_ns()
        self._write_activity(_ACTIVITY_AT, now_ns, activity)
        return now_ns

    def show_idle(self) -> None:
        """Show that the module does nothing."""
        self._words[_ACTIVITY] = _IDLE

    def release(self, delivery: Delivery) -> None:
        """Tell the core that a message was handled and its memory is no longer in use."""
        self._endpoint.release(delivery)

    def done(self, delivery: Delivery) -> None:
        """Tell the core that a message was handled, but its memory is still in use."""
        self._endpoint.done(delivery)

    def tell_lost(self, error: RobbieError) -> None:
        """Count a message that could not be decoded, and say why."""
        self.subscriptions.refuse_current(error)

    def name_current(self) -> ChannelName:
        """Return type, version and topic of the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        current = self.current
        if current is None:
            raise LookupError("a message has a name only while it is being handled")
        return self._channel_name(current.channel)

    def _is_unreferenced(self, reference: int) -> bool:
        """Check the finalizer's list, not the weak reference, which is dead before the finalizer has run."""
        try:
            self._unreferenced.remove(reference)
        except ValueError:
            return False
        return True

    def release_unreferenced(self) -> None:
        """Release the messages that a handler kept and nothing refers to any more."""
        unreferenced = self._unreferenced
        while unreferenced:
            self._endpoint.release(self._pins.remove(unreferenced.popleft()))

    def close(self) -> None:
        """Let go of the memory; nothing may be handled any more."""
        if self.native is not None:
            self.native.close()
        self._pins.close()

    def _may_pin(self, delivery: Delivery) -> bool:
        """Whether this module's limits leave room for a message that it might pin."""
        return self._pins.have_room_for(delivery, self._views.free_bytes(delivery.source))

    def _show_refused(self, total: int) -> None:
        self._words[layout.OUT_ILL_FORMED] = total

    def _copy(self, view: memoryview) -> memoryview:
        """Copy a message out of its publisher's memory, with the same alignment of its body."""
        self._copied += 1
        self._words[layout.OUT_COPIED] = self._copied
        copy = np.empty(LEAD_BYTES + len(view), np.uint8)[LEAD_BYTES:]
        copy[:] = view
        copy.flags.writeable = False
        return copy.data
