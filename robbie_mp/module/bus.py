"""The bus: what a module can do with messages, whether it runs in a robot, in a tool or in a test."""

import logging
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Protocol

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages.errors import MessageError
from robbie_mp.messages.message import Message
from robbie_mp.module.calls.peers import Peers
from robbie_mp.module.envelope import EncodedMessage, Envelope, MessageType
from robbie_mp.module.subscriptions import Subscription, Subscriptions
from robbie_mp.module.wiring import UNCHANGED, Wiring


class PublishAfterStop(RobbieError, RuntimeError):
    """A module published after it was stopped; publish last messages in `teardown()`.

    Example scenarios:
      - a thread of the module still runs after `teardown()` has returned
    """


class Bus(Protocol):
    """A module's connection to the others."""

    @property
    def subscriptions(self) -> Subscriptions:
        """The subscriptions of the module."""

    @property
    def peers(self) -> Peers:
        """The other modules, to call them."""

    @property
    def outstanding(self) -> int:
        """Number of this module's messages that subscribers still wait for or hold."""

    def advertise(self, message_type: type[Message], topic: str) -> None:
        """Declare that the module may publish messages of a type, before it does."""

    def publish(self, message: Message | EncodedMessage, topic: str, latched: bool = False) -> bool:
        """Publish a message; False if it was refused (and counted) because memory or ring is full.

        With `latched`, here and below, later subscribers of the channel get its newest message first.
        """

    def loan(
        self,
        message_type: type[MessageType],
        topic: str,
        fields: Mapping[str, object],
        latched: bool = False,
    ) -> AbstractContextManager[MessageType]:
        """Lend a message to be filled in place; it is published at the end of the `with` block."""

    def newest_stamp_ns(self, subscribed: ChannelName) -> int:
        """Return when the newest message that has come for a subscription was published; -1: none has come.

        In ns of the machine's monotonic time.

        Args:
            subscribed: the name that `subscriptions.subscribe` returned.
        """

    def show_deadline(
        self, subscribed: ChannelName, deadline_ns: int, latenesses: int, greatest_age_ns: int
    ) -> None:
        """Show observers the deadline of a subscription, how often it was missed, and how late at most."""

    def wake_after_freed(self, messages: int) -> None:
        """Wake this module when all subscribers have released this number of its messages."""

    def sender(self) -> str:
        """Return the name of the module that published the message being handled; raises as `envelope`."""

    def envelope(self) -> Envelope:
        """Return the envelope of the message being handled."""


class CopyingBus:
    """What the buses of tools and tests have in common: handlers get copies, and nobody observes them.

    Args:
        request: requests the messages of a subscription; returns the number that they will carry.
        wiring: the names that the profile gives to the module's topics.
    """

    def __init__(self, request: Callable[[Subscription], int], wiring: Wiring = UNCHANGED):
        self.subscriptions = Subscriptions(request, self._current_name, wiring)
        self._log = logging.getLogger("robbie.receive")
        self._name: ChannelName | None = None
        self._envelope: Envelope | None = None
        self._newest_ns: dict[ChannelName, int] = {}
        """When the newest message of each subscription was published."""

    def hand_over(
        self, subscription: Subscription, name: ChannelName, envelope: Envelope, data: bytes
    ) -> None:
        """Decode a message, and run the handler of a subscription."""
        refusals, newest_ns = self.subscriptions.refusals, self._newest_ns.get(subscription.name, -1)
        refused = refusals.total
        self._name, self._envelope = name, envelope
        self._newest_ns[subscription.name] = envelope.published_ns
        is_handled = False
        try:
            message = subscription.decoder.decode(memoryview(data))
        except MessageError as error:
            self.lose(error)
        else:
            subscription.handler(message)
            is_handled = refusals.total == refused
        finally:
            self._name = self._envelope = None
            if not is_handled:
                self._newest_ns[subscription.name] = newest_ns

    def lose(self, error: MessageError) -> None:
        """Count a message that could not be decoded, and say why."""
        self.subscriptions.refuse_current(error)

    def _current_name(self) -> ChannelName:
        assert self._name is not None
        return self._name

    def newest_stamp_ns(self, subscribed: ChannelName) -> int:
        """Return when the newest message of a subscription was published; -1: none has come."""
        return self._newest_ns.get(subscribed, -1)

    def show_deadline(
        self, subscribed: ChannelName, deadline_ns: int, latenesses: int, greatest_age_ns: int
    ) -> None:
        """Do nothing: the log says what is late."""

    def sender(self) -> str:
        """Return who published the message being handled; raises as `envelope`."""
        return self.envelope().sender

    def envelope(self) -> Envelope:
        """Return the envelope of the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        if self._envelope is None:
            raise LookupError("there is an envelope only while a message is being handled")
        return self._envelope
