"""Receives messages: decodes them in the publisher's memory, releases them when nothing refers to them."""

import logging
import weakref
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from robbie_mp.errors import RobbieError
from robbie_mp.module.subscriptions import Subscription, Subscriptions
from robbie_mp.transport import layout
from robbie_mp.transport.blocks import LEAD_BYTES
from robbie_mp.transport.endpoint import Endpoint
from robbie_mp.transport.records import Delivery, Inbound
from robbie_mp.transport.tables import ChannelName
from robbie_mp.transport.views import SegmentViews
from robbie_mp.transport.words import Words

_SOURCE_OF_INCARNATION = layout.SOURCE_OF_INCARNATION
MAX_PINNED = 256
"""Most messages of one publisher that a module pins; its handlers get copies of further ones."""
PINNED_SHARE = 8
"""Beyond its first message, a module pins at most an eighth of what the publisher has free. So n modules that
keep all they can leave the publisher 8 / (8 + n) of its memory.

A limit relative to the free memory needs no knowledge of the other modules, and always leaves some memory:
Choudhury and Hahne, Dynamic queue length thresholds for shared-memory packet switches, IEEE/ACM Transactions
on Networking 6(2), 1998.
"""


class DamagedMessage(RobbieError, ValueError):
    """A handle does not point to a message of its type; the publisher's memory is damaged."""


class Inbox:
    """Takes messages one by one. Belongs to the module's main thread.

    Args:
        endpoint: the module's connection to the core.
        views: maps of the publishers' memory.
        words: the module's out segment, for the counters.
        channel_name: returns type, version and topic of a channel's messages.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        views: SegmentViews,
        words: Words,
        channel_name: Callable[[int], ChannelName],
    ):
        self._endpoint = endpoint
        self._views = views
        self._words = words
        self._log = logging.getLogger("robbie.receive")
        self._channel_name = channel_name
        self.subscriptions = Subscriptions(self._request, self.name_current)
        self._by_number = self.subscriptions.by_number
        self._pinned: dict[int, tuple[weakref.ref[Any], Delivery]] = {}
        self._unreferenced: deque[int] = deque()
        """References to messages that nothing refers to any more; filled by finalizers, in any thread."""
        self._pinned_of: dict[int, _Pinned] = {}
        """What is pinned of each publisher's incarnation, by the common part of its sources."""
        self._pinned_bytes = 0
        self._handled = 0
        self._copied = 0
        self.current: Delivery | None = None
        self.before_release: Callable[[], None] | None = None
        """Called when a message has been handled, before other processes can see that it was."""

    def _request(self, subscription: Subscription) -> int:
        handler = subscription.handler
        handler_name = getattr(handler, "__qualname__", type(handler).__qualname__)
        return self._endpoint.subscribe(*subscription.name, subscription.handling, handler_name)

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
        self.current = delivery
        _, _, decoder, handler = self._by_number[delivery.declaration]
        pin: weakref.ref[Any] | None = None
        try:
            view = self._views.view(delivery.source, delivery.offset, delivery.size)
            if len(view) != delivery.size:
                raise DamagedMessage(
                    f"message {delivery.sequence} lies beyond the end of its publisher's memory"
                )
            if decoder.has_views and not (self._pinned_of and self._pins_too_much(delivery)):
                whole = np.frombuffer(view, np.uint8)
                unreferenced, reference = self._unreferenced, delivery.reference
                pin = weakref.ref(whole, lambda _: unreferenced.append(reference))
                message = decoder.decode(whole.data)
                del whole
            elif decoder.has_views:
                message = decoder.decode(self._copy(view))
            else:
                message = decoder.decode(view)
        except RobbieError as error:
            self._log.error(
                "a message was lost: %s", str(error)
            )  # the error itself would hold frames and views
        else:
            handler(message)
            del message
        self.current = None
        self._handled += 1
        self._words[layout.OUT_HANDLED] = self._handled
        if self.before_release is not None:
            self.before_release()
        if pin is None or self._is_unreferenced(delivery.reference):
            self._endpoint.release(delivery)
        else:
            self._pinned[delivery.reference] = (pin, delivery)
            self._count_pinned(delivery, 1)
            self._endpoint.done(delivery)

    def name_current(self) -> ChannelName:
        """Return type, version and topic of the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        if self.current is None:
            raise LookupError("a message has a name only while it is being handled")
        return self._channel_name(self.current.channel)

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
            _, delivery = self._pinned.pop(unreferenced.popleft())
            self._count_pinned(delivery, -1)
            self._endpoint.release(delivery)

    def _pins_too_much(self, delivery: Delivery) -> bool:
        """Whether this module has reached its limit of pinned messages or bytes of a publisher."""
        pinned = self._pinned_of.get(delivery.source & _SOURCE_OF_INCARNATION)
        if pinned is None:
            return False
        free_bytes = self._views.free_bytes(delivery.source)
        return pinned.messages >= MAX_PINNED or PINNED_SHARE * (pinned.bytes + delivery.size) > free_bytes

    def _copy(self, view: memoryview) -> memoryview:
        """Copy a message out of its publisher's memory, with the same alignment of its body."""
        self._copied += 1
        self._words[layout.OUT_COPIED] = self._copied
        copy = np.empty(LEAD_BYTES + len(view), np.uint8)[LEAD_BYTES:]
        copy[:] = view
        copy.flags.writeable = False
        return copy.data

    def _count_pinned(self, delivery: Delivery, change: int) -> None:
        """Count a message that is now pinned (1), or no longer (-1)."""
        publisher = delivery.source & _SOURCE_OF_INCARNATION
        pinned = self._pinned_of.setdefault(publisher, _Pinned())
        pinned.messages += change
        pinned.bytes += change * delivery.size
        if not pinned.messages:
            del self._pinned_of[publisher]
        self._pinned_bytes += change * delivery.size
        self._words[layout.OUT_PINNED] = len(self._pinned)
        self._words[layout.OUT_PINNED_BYTES] = self._pinned_bytes


class _Pinned:
    """What a module pins of one incarnation of a publisher."""

    __slots__ = ("bytes", "messages")

    def __init__(self) -> None:
        self.messages = 0
        self.bytes = 0
