"""The bus: what a module can do with messages, whether it runs in a robot, in a tool or in a test."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Protocol

from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import Message
from robbie_mp.module.calls.peers import Peers
from robbie_mp.module.envelope import Envelope, MessageType
from robbie_mp.module.subscriptions import Subscriptions


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

    def publish_encoded(
        self,
        type_name: str,
        version: int,
        data: bytes | bytearray | memoryview,
        topic: str,
        latched: bool = False,
    ) -> bool:
        """Publish an encoded message; False if it was refused, as `publish`."""

    def advertise(self, message_type: type[Message], topic: str) -> None:
        """Declare that the module may publish messages of a type, before it does."""

    def publish(self, message: Message, topic: str, latched: bool = False) -> bool:
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
