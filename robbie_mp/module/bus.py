"""What a module can do with messages, wherever it runs: in a process of its own or in a test."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import NamedTuple, Protocol, TypeVar

from robbie_mp.errors import RobbieError
from robbie_mp.messages import Message
from robbie_mp.transport.records import MessageHandling

MessageType = TypeVar("MessageType", bound=Message)


class PublishAfterStop(RobbieError, RuntimeError):
    """A module published after it was stopped; publish what is last in `teardown()`.

    Example scenarios:
      - a thread of the module goes on after `teardown()` has returned
    """


class SubscribedTwice(RobbieError, ValueError):
    """A module subscribed twice to the same messages; one handler may call the other.

    Example scenarios:
      - two helpers of a module each subscribe to ModuleState for all topics
    """

    def __init__(self, type_name: str, topic: str):
        super().__init__(
            f"this module subscribes to {type_name} on topic '{topic}' already; "
            "let one handler call the other"
        )


class EmptyPattern(RobbieError, ValueError):
    """A module subscribed by an empty pattern for the type; no type has an empty name."""

    def __init__(self) -> None:
        super().__init__("an empty pattern matches no type; '*' matches all")


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
    def outstanding(self) -> int:
        """Messages published by this module that somebody still waits for or holds."""

    def subscribe(
        self,
        message_type: type[MessageType],
        handler: Callable[[MessageType], None],
        handling: MessageHandling,
        topic: str,
    ) -> None:
        """Have messages of a type handled, of all topics ('') or of one."""

    def subscribe_encoded(
        self, type_pattern: str, handler: Callable[[EncodedMessage], None], topic_pattern: str
    ) -> None:
        """Have messages whose type and topic match shell patterns handled as their bytes."""

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
