"""Typed messages in: decoded from the publisher's memory, handled, released when nobody looks any more."""

import logging
import weakref
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from robbie_mp.bus import MessageType, SubscribedTwice
from robbie_mp.errors import RobbieError
from robbie_mp.messages import Message
from robbie_mp.transport import layout
from robbie_mp.transport.endpoint import Delivery, Endpoint
from robbie_mp.transport.records import Inbound, MessageHandling
from robbie_mp.transport.views import SegmentViews
from robbie_mp.transport.words import Words


class DamagedMessage(RobbieError, ValueError):
    """A handle does not lead to a message of its type; the publisher's memory is damaged."""


class Inbox:
    """Takes messages one by one. Belongs to the module's main thread.

    Args:
        endpoint: the module's connection to the core.
        views: maps of the publishers' memory.
        words: the module's out segment, for the counters.
    """

    def __init__(self, endpoint: Endpoint, views: SegmentViews, words: Words):
        self._endpoint = endpoint
        self._views = views
        self._words = words
        self._log = logging.getLogger("robbie.receive")
        self._handlers: dict[int, tuple[type[Message], Callable[[Any], None]]] = {}
        self._subscribed: set[tuple[type[Message], str]] = set()
        self._pinned: dict[int, tuple[weakref.ref[Any], Delivery]] = {}
        self._let_go: deque[int] = deque()
        """References whose memory nobody looks at any more; filled by finalizers, in any thread."""
        self._pinned_bytes = 0
        self._handled = 0
        self.current: Delivery | None = None

    def subscribe(
        self,
        message_type: type[MessageType],
        handler: Callable[[MessageType], None],
        handling: MessageHandling,
        topic: str,
    ) -> None:
        """Have messages of a type handled.

        Raises:
            SubscribedTwice: the module has subscribed to them already.
        """
        if (message_type, topic) in self._subscribed:
            raise SubscribedTwice(
                f"this module subscribes to {message_type.type_name} on topic '{topic}' already; "
                "let one handler call the other"
            )
        self._subscribed.add((message_type, topic))
        name = getattr(handler, "__qualname__", type(handler).__qualname__)
        number = self._endpoint.subscribe(message_type.type_name, message_type.version, topic, handling, name)
        self._handlers[number] = (message_type, handler)

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
        message_type, handler = self._handlers[delivery.declaration]
        pin: weakref.ref[Any] | None = None
        try:
            view = self._views.view(delivery.source, delivery.offset, delivery.size)
            if len(view) != delivery.size:
                raise DamagedMessage(
                    f"message {delivery.sequence} is said to lie beyond the end of its publisher's memory"
                )
            if message_type.has_views:
                whole = np.frombuffer(view, np.uint8)
                let_go, reference = self._let_go, delivery.reference
                pin = weakref.ref(whole, lambda _: let_go.append(reference))
                message = message_type.decode(whole.data)
                del whole
            else:
                message = message_type.decode(view)
        except RobbieError as error:
            self._log.error("a message was lost: %s", str(error))  # the error would hold frames and views
        else:
            handler(message)
            del message
        self.current = None
        self._handled += 1
        self._words[layout.OUT_HANDLED] = self._handled
        if pin is None or self._is_let_go(delivery.reference):
            self._endpoint.release(delivery)
        else:
            self._pinned[delivery.reference] = (pin, delivery)
            self._count_pinned(delivery.size)
            self._endpoint.done(delivery)

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
            self._count_pinned(-delivery.size)
            self._endpoint.release(delivery)

    def _count_pinned(self, more_bytes: int) -> None:
        self._pinned_bytes += more_bytes
        self._words[layout.OUT_PINNED] = len(self._pinned)
        self._words[layout.OUT_PINNED_BYTES] = self._pinned_bytes
