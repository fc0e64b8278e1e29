"""The subscriptions of a module and their handlers: the same on every bus."""

import logging
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.records import ANY_VERSION, MessageHandling
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages.calls import Goal, Reply, Request, Result
from robbie_mp.messages.message import Message, check_message_type
from robbie_mp.messages.refusals import Refusals
from robbie_mp.messages.well_formed import find_flaw, ill_formed
from robbie_mp.module.envelope import EncodedMessage, MessageType
from robbie_mp.module.handlers import check_handler
from robbie_mp.module.wiring import UNCHANGED, TopicsMeet, Wiring, check_topic

ANSWERED = (Request, Goal, Reply, Result)
"""Messages for which somebody waits: server and client check them."""


class SubscribedTwice(RobbieError, ValueError):
    """A module subscribed twice to the same messages; one handler may call the other.

    Example scenarios:
      - two helpers of a module each subscribe to ModuleState for all topics
    """

    def __init__(self, type_name: str, topic: str):
        super().__init__(
            f"this module has already subscribed to {type_name} on topic '{topic}'; "
            "let one handler call the other"
        )


class EmptyPattern(RobbieError, ValueError):
    """A module subscribed with an empty pattern for the type; no type has an empty name."""

    def __init__(self) -> None:
        super().__init__("an empty pattern matches no type; '*' matches all")


class Decoder(Protocol):
    """Turns the bytes of a message into what its handler gets."""

    @property
    def has_views(self) -> bool:
        """Whether the result may refer to the bytes for as long as it lives."""

    def decode(self, buffer: memoryview, /) -> Any:
        """Return what the handler gets."""


class Subscription(NamedTuple):
    """One subscription of a module."""

    name: ChannelName
    """Type, version and topic in the run ('' for all topics, 'laser/' for all that begin so); with
    ANY_VERSION, shell patterns for type and topic."""
    handling: MessageHandling
    decoder: Decoder
    handler: Callable[[Any], None]
    is_optional: bool = True
    """Whether the module works without these messages, so that nobody needs to publish them."""
    own_topic: str = ""
    """The topic as the module's code names it; the profile may have given it another name."""


class Subscriptions:
    """A module's subscriptions on one bus.

    Args:
        request: requests the messages of a subscription; returns the number that they will carry.
        current_name: returns type, version and topic of the message that is being handled.
        wiring: the names that the profile gives to the module's topics.

    Attributes:
        by_number: the subscriptions by the number that their messages carry.
        numbers: these numbers by the name of the subscription.
        refusals: the messages that no handler got, because they were ill-formed.
        check_class: raises an error if a class may not be subscribed to in this run.
    """

    def __init__(
        self,
        request: Callable[[Subscription], int],
        current_name: Callable[[], ChannelName],
        wiring: Wiring = UNCHANGED,
    ):
        self._request = request
        self._current_name = current_name
        self._wiring = wiring
        self.refusals = Refusals(logging.getLogger("robbie.receive"))
        self.check_class: Callable[[type[Message]], None] = lambda _: None
        self._as_bytes = _AsBytes(current_name)
        self._by_name: dict[ChannelName, Subscription] = {}
        self.by_number: dict[int, Subscription] = {}
        self.numbers: dict[ChannelName, int] = {}

    def __iter__(self) -> Iterator[Subscription]:
        """Iterate over the subscriptions made so far, in the order in which they were made."""
        return iter(list(self._by_name.values()))

    def subscribe(
        self,
        message_type: type[MessageType],
        handler: Callable[[MessageType], None],
        handling: MessageHandling,
        topic: str,
        *,
        optional: bool = True,
    ) -> ChannelName:
        """Subscribe to the messages of a type.

        Args:
            message_type: the class of the messages.
            handler: called with each message that is well formed.
            handling: what to do when messages come faster than they are handled.
            topic: '' for all topics.
            optional: whether the module works without them.

        Returns:
            The name of the subscription.

        Raises:
            NotAMessage: `message_type` is not a class of messages.
            InvalidHandler: `handler` cannot be called with a message.
            InvalidTopic: not everything could carry the topic's name.
            SubscribedTwice: the module has already subscribed to them.
            TopicsMeet: it has, on another topic to which the profile gives the same name.
        """
        check_message_type(message_type, "subscribe")
        check_topic(topic)
        check_handler("subscribe", handler, f"message: {message_type.__name__}")
        self.check_class(message_type)
        type_name = message_type.type_name
        name = ChannelName(type_name, message_type.version, self._wiring.subscribed(type_name, topic))
        handler = self._checked(message_type, handler)
        self._add(Subscription(name, handling, message_type, handler, optional, topic))
        return name

    def _checked(
        self, message_type: type[MessageType], handler: Callable[[MessageType], None]
    ) -> Callable[[MessageType], None]:
        """Return a handler that does not get ill-formed messages; those of calls get an answer instead."""
        if not message_type.has_rules or issubclass(message_type, ANSWERED):
            return handler

        def handle(message: MessageType) -> None:
            if (flaw := find_flaw(message)) is None:
                handler(message)
            else:
                self.refuse_current(ill_formed(message.type_name, flaw))

        handle.__qualname__ = getattr(handler, "__qualname__", type(handler).__qualname__)
        return handle

    def refuse_current(self, error: RobbieError) -> None:
        """Count the message being handled as one that no handler gets.

        Args:
            error: says why.
        """
        self.refusals.count(error, self._origin())

    def _origin(self) -> str:
        topic = self._current_name().topic
        return f"on topic '{topic}'" if topic else ""

    def subscribe_encoded(
        self,
        type_pattern: str,
        handler: Callable[[EncodedMessage], None],
        topic_pattern: str,
        version: int = ANY_VERSION,
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
    ) -> None:
        """Subscribe to all messages whose type and topic match shell patterns; the handler gets their bytes.

        With a version, type and topic are names instead of patterns.

        Raises:
            SubscribedTwice: the module has already subscribed with the same patterns.
            EmptyPattern: the pattern for the type is empty.
            InvalidHandler: `handler` cannot be called with a message.
        """
        if not type_pattern:
            raise EmptyPattern
        check_handler("subscribe_encoded", handler, "message: EncodedMessage")
        name = ChannelName(type_pattern, version, self._wiring.subscribed(type_pattern, topic_pattern))
        self._add(Subscription(name, handling, self._as_bytes, handler, own_topic=topic_pattern))

    def forget(self, message_type: type[Message], topic: str) -> None:
        """Forget a subscription, so that `request_again` leaves it out.

        Args:
            message_type: the class of the messages.
            topic: as given to `subscribe`.
        """
        type_name = message_type.type_name
        actual = self._wiring.actual(type_name, topic)
        del self._by_name[ChannelName(type_name, message_type.version, actual)]

    def request_again(self) -> None:
        """Request the messages of all subscriptions from a core that does not know them."""
        self.by_number.clear()
        for subscription in self:
            self._number(subscription)

    def _add(self, subscription: Subscription) -> None:
        name = subscription.name
        if name in self._by_name:
            other = self._by_name[name].own_topic
            if other != subscription.own_topic:
                raise TopicsMeet(name.type_name, subscription.own_topic, other, name.topic)
            raise SubscribedTwice(name.type_name, name.topic)
        self._by_name[name] = subscription
        self._number(subscription)

    def _number(self, subscription: Subscription) -> None:
        number = self.numbers[subscription.name] = self._request(subscription)
        self.by_number[number] = subscription


class _AsBytes:
    """Leaves a message as its bytes."""

    has_views = True

    def __init__(self, current_name: Callable[[], ChannelName]):
        self._current_name = current_name

    def decode(self, buffer: memoryview) -> EncodedMessage:
        """Return the bytes with the message's type and version."""
        type_name, version, _ = self._current_name()
        return EncodedMessage(type_name, version, buffer)
