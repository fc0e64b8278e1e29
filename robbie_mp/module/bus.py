"""What a module can do with messages, wherever it runs: in a process of its own or in a test."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

from robbie_mp.errors import RobbieError
from robbie_mp.messages import Message

if TYPE_CHECKING:
    from robbie_mp.module.subscriptions import Subscriptions

MessageType = TypeVar("MessageType", bound=Message)


class PublishAfterStop(RobbieError, RuntimeError):
    """A module published after it was stopped; publish what is last in `teardown()`.

    Example scenarios:
      - a thread of the module goes on after `teardown()` has returned
    """


class Envelope(NamedTuple):
    """What came with a message."""

    topic: str
    sequence: int
    """Its place in the one order of all messages of the run."""
    sender: str
    """Name of the module that published it."""
    published_ns: int
    """When, on the monotonic clock that the module goes by."""


class EncodedMessage(NamedTuple):
    """A message as its bytes, of a type that this program need have no class for."""

    type_name: str
    version: int
    data: memoryview
    """Its encoding with the 4 bytes of encapsulation, read-only, in the memory of who published it.

    Who keeps it, or an array over it, beyond the handler keeps the message in that memory, as with arrays of
    any other message: take `bytes(data)` to keep it for long.
    """


class Bus(Protocol):
    """A module's connection to the others."""

    @property
    def subscriptions(self) -> "Subscriptions":
        """What the module has subscribed to."""

    @property
    def outstanding(self) -> int:
        """Messages published by this module that somebody still waits for or holds."""

    def publish_encoded(
        self, type_name: str, version: int, data: bytes | bytearray | memoryview, topic: str
    ) -> bool:
        """Send a message given as its bytes; False if it was refused, as `publish`."""

    def publish(self, message: Message, topic: str) -> bool:
        """Send a message; False if it was refused (and counted) because memory or ring are full."""

    def loan(
        self, message_type: type[MessageType], topic: str, fields: Mapping[str, object]
    ) -> AbstractContextManager[MessageType]:
        """Have a message written in place and published at the end of the `with` block."""

    def wake_after_freed(self, messages: int) -> None:
        """Wake this module when so many of its messages have been let go by everybody."""

    def envelope(self) -> Envelope:
        """What came with the message being handled."""
