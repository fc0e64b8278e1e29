"""Typed messages in: decoded from the publisher's memory, handled, released when nobody looks any more."""

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
from robbie_mp.transport.endpoint import ChannelName, Delivery, Endpoint
from robbie_mp.transport.records import Inbound
from robbie_mp.transport.views import SegmentViews
from robbie_mp.transport.words import Words

_SOURCE_OF_INCARNATION = layout.SOURCE_OF_INCARNATION
MAX_PINNED = 256
"""Messages of one publisher that a module pins; each further one that it looks at is a copy."""
PINNED_SHARE = 8
"""Beyond the first one, it pins no message with which it would pin more than an eighth of what its publisher
has free. So n modules that keep all they can get leave it 8 / (8 + n) of its memory.

A limit that is a part of what is free needs to know neither who else there is nor what they take, and always
leaves something: Choudhury and Hahne, Dynamic queue length thresholds for shared-memory packet switches,
IEEE/ACM Transactions on Networking 6(2), 1998.
"""


class DamagedMessage(RobbieError, ValueError):
    """A handle does not lead to a message of its type; the publisher's memory is damaged."""


class Inbox:
    """Takes messages one by one. Belongs to the module's main thread.

    Args:
        endpoint: the module's connection to the core.
        views: maps of the publishers' memory.
        words: the module's out segment, for the counters.
        channel_name: says what the messages of a channel are.
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
        self._let_go: deque[int] = deque()
        """References whose memory nobody looks at any more; filled by finalizers, in any thread."""
        self._pinned_of: dict[int, _Pinned] = {}
        """What of it is whose, by what the sources of a publisher's incarnation have in common."""
        self._pinned_bytes = 0
        self._handled = 0
        self._copied = 0
        self.current: Delivery | None = None
        self.before_release: Callable[[], None] | None = None
        """Called when a message has been handled, before anybody else can know that."""

    def _request(self, subscription: Subscription) -> int:
        handler = subscription.handler
        handler_name = getattr(handler, "__qualname__", type(handler).__qualname__)
        return self._endpoint.subscribe(*subscription.name, subscription.handling, handler_name)

    def take(self) -> Delivery | None:
        """Take the next message, which is from then on being handled; None if there is none."""
        if self._let_go:
            self.release_let_go()
        while (record := self._endpoint.take()) is not None:
            if isinstance(record, Delivery):
                return record
            if record.kind is Inbound.SEGMENTS_GONE:
                self._views.drop(record.slot, record.incarnation)
        return None

    def handle(self, delivery: Delivery) -> None:
        """Run the handler of a message, then release the message or remember that it is still looked at."""
        self.current = delivery
        _, _, decoder, handler = self._by_number[delivery.declaration]
        pin: weakref.ref[Any] | None = None
        try:
            view = self._views.view(delivery.source, delivery.offset, delivery.size)
            if len(view) != delivery.size:
                raise DamagedMessage(
                    f"message {delivery.sequence} is said to lie beyond the end of its publisher's memory"
                )
            if decoder.has_views and not (self._pinned_of and self._pins_too_much(delivery)):
                whole = np.frombuffer(view, np.uint8)
                let_go, reference = self._let_go, delivery.reference
                pin = weakref.ref(whole, lambda _: let_go.append(reference))
                message = decoder.decode(whole.data)
                del whole
            elif decoder.has_views:
                message = decoder.decode(self._copy(view))
            else:
                message = decoder.decode(view)
        except RobbieError as error:
            self._log.error("a message was lost: %s", str(error))  # the error would hold frames and views
        else:
            handler(message)
            del message
        self.current = None
        self._handled += 1
        self._words[layout.OUT_HANDLED] = self._handled
        if self.before_release is not None:
            self.before_release()
        if pin is None or self._is_let_go(delivery.reference):
            self._endpoint.release(delivery)
        else:
            self._pinned[delivery.reference] = (pin, delivery)
            self._count_pinned(delivery, 1)
            self._endpoint.done(delivery)

    def name_current(self) -> ChannelName:
        """Say what the message being handled is.

        Raises:
            LookupError: no message is being handled.
        """
        if self.current is None:
            raise LookupError("a message has a name only while it is being handled")
        return self._channel_name(self.current.channel)

    def _is_let_go(self, reference: int) -> bool:
        """Ask the finalizer's list and not the weak reference, which is dead before the finalizer has run."""
        try:
            self._let_go.remove(reference)
        except ValueError:
            return False
        return True

    def release_let_go(self) -> None:
        """Release the messages that were kept beyond their handler and have been let go since."""
        let_go = self._let_go
        while let_go:
            _, delivery = self._pinned.pop(let_go.popleft())
            self._count_pinned(delivery, -1)
            self._endpoint.release(delivery)

    def _pins_too_much(self, delivery: Delivery) -> bool:
        """Whether this module pins so much of a publisher's memory that others need the rest."""
        pinned = self._pinned_of.get(delivery.source & _SOURCE_OF_INCARNATION)
        if pinned is None:
            return False
        free_bytes = self._views.free_bytes(delivery.source)
        return pinned.messages >= MAX_PINNED or PINNED_SHARE * (pinned.bytes + delivery.size) > free_bytes

    def _copy(self, view: memoryview) -> memoryview:
        """Copy a message out of its publisher's memory, with its body aligned as it is there."""
        self._copied += 1
        self._words[layout.OUT_COPIED] = self._copied
        copy = np.empty(LEAD_BYTES + len(view), np.uint8)[LEAD_BYTES:]
        copy[:] = view
        copy.flags.writeable = False
        return copy.data

    def _count_pinned(self, delivery: Delivery, change: int) -> None:
        """Count a message that is pinned from now on (1), or is no more (-1)."""
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
