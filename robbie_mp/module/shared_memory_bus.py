"""The bus of a module in a process of its own."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager

from robbie_mp.messages import Message
from robbie_mp.module.bus import Envelope, MessageType
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.outbox import Outbox
from robbie_mp.transport.endpoint import Delivery


class SharedMemoryBus:
    """Joins outbox and inbox to what `robbie_mp.module.bus.Bus` asks for.

    Args:
        outbox: where messages leave.
        inbox: where they come in.
        describe: makes the envelope of a delivery from the tables of core and supervisor.
    """

    def __init__(self, outbox: Outbox, inbox: Inbox, describe: Callable[[Delivery], Envelope]):
        self._outbox = outbox
        self.publish: Callable[[Message, str], bool] = outbox.publish
        """Send a message; False if it was refused."""
        self._inbox = inbox
        self.subscriptions = inbox.subscriptions
        self._describe = describe

    @property
    def outstanding(self) -> int:
        """Messages published by this module that somebody still waits for or holds."""
        return self._outbox.outstanding

    def publish_encoded(
        self, type_name: str, version: int, data: bytes | bytearray | memoryview, topic: str
    ) -> bool:
        """Send a message given as its bytes; False if it was refused."""
        return self._outbox.publish_encoded(type_name, version, data, topic)

    def loan(
        self, message_type: type[MessageType], topic: str, fields: Mapping[str, object]
    ) -> AbstractContextManager[MessageType]:
        """Have a message written in place."""
        return self._outbox.loan(message_type, topic, fields)

    def wake_after_freed(self, messages: int) -> None:
        """Wake this module when so many of its messages have been let go by everybody."""
        self._outbox.wake_after_freed(messages)

    def envelope(self) -> Envelope:
        """What came with the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        if self._inbox.current is None:
            raise LookupError("there is an envelope only while a message is being handled")
        return self._describe(self._inbox.current)
