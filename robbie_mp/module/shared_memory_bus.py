"""The bus of a module that runs in its own process."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Protocol

from robbie_mp.bus.transport.records import Delivery
from robbie_mp.messages import Message
from robbie_mp.module.calls.peers import Peers
from robbie_mp.module.envelope import Envelope, MessageType
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.outbox import Outbox

NOTHING_HANDLED = "there is an envelope only while a message is being handled"


class _Publish(Protocol):
    def __call__(self, message: Message, topic: str, latched: bool = False) -> bool: ...


class Describer(Protocol):
    """Knows what the tables of the core and the supervisor say about a delivery."""

    def sender(self, source: int) -> str:
        """Return the name of the module whose memory a message lies in."""

    def envelope(self, delivery: Delivery) -> Envelope:
        """Return the envelope of a message."""


class SharedMemoryBus:
    """Implements `robbie_mp.module.bus.Bus` with an outbox and an inbox.

    Args:
        outbox: publishes the module's messages.
        inbox: receives messages for the module.
        describe: says what is known about a delivery.
        peers: the other modules.
    """

    def __init__(self, outbox: Outbox, inbox: Inbox, describe: Describer, peers: Peers):
        self.peers = peers
        self._outbox = outbox
        self.publish: _Publish = outbox.publish
        """Publish a message; False if it was refused."""
        self._inbox = inbox
        self.subscriptions = inbox.subscriptions
        self.newest_stamp_ns = inbox.newest_stamp_ns
        self.show_deadline = inbox.show_deadline
        self._describe = describe

    @property
    def outstanding(self) -> int:
        """Number of this module's messages that subscribers still wait for or hold."""
        return self._outbox.outstanding

    def publish_encoded(
        self,
        type_name: str,
        version: int,
        data: bytes | bytearray | memoryview,
        topic: str,
        latched: bool = False,
    ) -> bool:
        """Publish an encoded message; False if it was refused."""
        return self._outbox.publish_encoded(type_name, version, data, topic, latched)

    def advertise(self, message_type: type[Message], topic: str) -> None:
        """Declare that the module may publish messages of a type."""
        self._outbox.advertise(message_type, topic)

    def loan(
        self,
        message_type: type[MessageType],
        topic: str,
        fields: Mapping[str, object],
        latched: bool = False,
    ) -> AbstractContextManager[MessageType]:
        """Lend a message to be filled in place."""
        return self._outbox.loan(message_type, topic, fields, latched)

    def wake_after_freed(self, messages: int) -> None:
        """Wake this module when all subscribers have released this number of its messages."""
        self._outbox.wake_after_freed(messages)

    def sender(self) -> str:
        """Return the name of the module that published the message being handled; raises as `envelope`."""
        source = self._inbox.source
        if source is None:
            raise LookupError(NOTHING_HANDLED)
        return self._describe.sender(source)

    def envelope(self) -> Envelope:
        """Return the envelope of the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        current = self._inbox.current
        if current is None:
            raise LookupError(NOTHING_HANDLED)
        return self._describe.envelope(current)
