"""Typed messages in: decoded from the publisher's memory, handled, released when nobody looks any more."""

import logging
import weakref
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from robbie_mp.bus import EmptyPattern, EncodedMessage, MessageType, SubscribedTwice
from robbie_mp.errors import RobbieError
from robbie_mp.transport import layout
from robbie_mp.transport.endpoint import ChannelName, Delivery, Endpoint
from robbie_mp.transport.records import ANY_VERSION, Inbound, MessageHandling
from robbie_mp.transport.views import SegmentViews
from robbie_mp.transport.words import Words


class DamagedMessage(RobbieError, ValueError):
    """A handle does not lead to a message of its type; the publisher's memory is damaged."""


class Decoder(Protocol):
    """Makes what is handled of a message's bytes: a message class, or what leaves the bytes as they are."""

    @property
    def has_views(self) -> bool:
        """Whether what it makes may look at the bytes for as long as it lives."""

    def decode(self, buffer: memoryview, /) -> Any:
        """Return what the handler gets."""


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
        self._handlers: dict[int, tuple[Decoder, Callable[[Any], None]]] = {}
        self._subscribed: set[tuple[str, int, str]] = set()
        self._pinned: dict[int, tuple[weakref.ref[Any], Delivery]] = {}
        self._let_go: deque[int] = deque()
        """References whose memory nobody looks at any more; filled by finalizers, in any thread."""
        self._pinned_bytes = 0
        self._handled = 0
        self.current: Delivery | None = None
        self.before_release: Callable[[], None] | None = None
        """Called when a message has been handled, before anybody else can know that."""

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
        wish = ChannelName(message_type.type_name, message_type.version, topic)
        self._subscribe(wish, handling, message_type, handler)

    def subscribe_encoded(
        self, type_pattern: str, handler: Callable[[EncodedMessage], None], topic_pattern: str
    ) -> None:
        """Have messages whose type and topic match shell patterns handled as their bytes.

        Raises:
            SubscribedTwice: the module has subscribed by the same patterns already.
            EmptyPattern: no type has such a name.
        """
        if not type_pattern:
            raise EmptyPattern
        wish = ChannelName(type_pattern, ANY_VERSION, topic_pattern)
        self._subscribe(wish, MessageHandling.ALWAYS_DELIVER, _AsBytes(self), handler)

    def _subscribe(
        self,
        wish: ChannelName,
        handling: MessageHandling,
        decoder: Decoder,
        handler: Callable[[Any], None],
    ) -> None:
        if wish in self._subscribed:
            raise SubscribedTwice(wish.type_name, wish.topic)
        self._subscribed.add(wish)
        name = getattr(handler, "__qualname__", type(handler).__qualname__)
        number = self._endpoint.subscribe(*wish, handling, name)
        self._handlers[number] = (decoder, handler)

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
        decoder, handler = self._handlers[delivery.declaration]
        pin: weakref.ref[Any] | None = None
        try:
            view = self._views.view(delivery.source, delivery.offset, delivery.size)
            if len(view) != delivery.size:
                raise DamagedMessage(
                    f"message {delivery.sequence} is said to lie beyond the end of its publisher's memory"
                )
            if decoder.has_views:
                whole = np.frombuffer(view, np.uint8)
                let_go, reference = self._let_go, delivery.reference
                pin = weakref.ref(whole, lambda _: let_go.append(reference))
                message = decoder.decode(whole.data)
                del whole
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
            self._count_pinned(delivery.size)
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
            self._count_pinned(-delivery.size)
            self._endpoint.release(delivery)

    def _count_pinned(self, more_bytes: int) -> None:
        self._pinned_bytes += more_bytes
        self._words[layout.OUT_PINNED] = len(self._pinned)
        self._words[layout.OUT_PINNED_BYTES] = self._pinned_bytes


class _AsBytes:
    """Leaves a message as its bytes."""

    has_views = True

    def __init__(self, inbox: Inbox):
        self._inbox = inbox

    def decode(self, buffer: memoryview) -> EncodedMessage:
        """Put type and version beside the bytes."""
        type_name, version, _ = self._inbox.name_current()
        return EncodedMessage(type_name, version, buffer)
