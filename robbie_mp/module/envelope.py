"""The arguments of a handler: a message, or its bytes, and the envelope it came in."""

from typing import NamedTuple, TypeVar

from robbie_mp.messages.message import Message

MessageType = TypeVar("MessageType", bound=Message)


class Envelope(NamedTuple):
    """The bus's knowledge about a message besides its content."""

    topic: str
    """As the module's code names it, whatever the profile calls it."""
    sequence: int
    """The message's place in the one order of all messages of the run."""
    sender: str
    """Name of the module that published it."""
    published_ns: int
    """When it was published: ns of the module's clock, as `clock.monotonic_ns()`."""


class EncodedMessage(NamedTuple):
    """An encoded message; this program needs no class for its type."""

    type_name: str
    version: int
    data: memoryview
    """The encoding with its 4 bytes of encapsulation: a read-only view of the publisher's memory.

    If you keep this view, or an array over it, after the handler returns, the message stays in that memory,
    as with the arrays of any other message. Copy it with `bytes(data)` to keep it for long.
    """
