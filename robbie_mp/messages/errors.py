"""Errors of the messages package."""

from robbie_mp.base.errors import RobbieError


class MessageError(RobbieError):
    """The root of the errors of this package."""


class DeclarationError(MessageError, TypeError):
    """The declaration of a message class has no encoding."""


class FieldError(MessageError):
    """A value does not fit its field; the text names message type, field, what was expected and given."""


class FieldTypeError(FieldError, TypeError):
    """A value has a type that its field cannot hold."""


class FieldValueError(FieldError, ValueError):
    """A value has the right type, but is out of range, too long, or of the wrong shape."""


class UnknownField(FieldError, TypeError):
    """A message is made with a field that its type does not have.

    Example scenarios:
      - `Twist(speed=…)`
      - a program was written for another version of the type
    """


class ImmutableMessage(FieldError, AttributeError):
    """A field of a message is set or deleted; a copy with another value comes from `replace()`."""


class IllFormed(FieldValueError):
    """The values of a message make no sense together, or none at all; the text says which, and what would.

    Example scenarios:
      - a position is NaN, or 1e12 m away
      - a map says that it has 100 x 100 cells, and holds 17

    Attributes:
        type_name: the type of the whole message.
        field: where in it, without the numbers of elements, to count by.
    """

    def __init__(self, text: str, type_name: str = "", field: str = ""):
        super().__init__(text)
        self.type_name = type_name
        self.field = field


class NotAMessage(MessageError, TypeError):
    """Something else was given where a message or a class of messages is wanted.

    Example scenarios:
      - a module publishes a dict
      - a module publishes the class instead of a message: `self.publish(LaserScan)`
    """


class BufferTooSmall(MessageError, ValueError):
    """A message does not fit into the given buffer."""


class DecodeError(MessageError, ValueError):
    """Bytes are not an encoding of the message type; the text names type, field and offset."""


class SchemaError(MessageError, ValueError):
    """A ros2msg schema text cannot be understood."""


class UnknownType(MessageError, LookupError):
    """A registry does not know the name of a message type."""


class DuplicateType(MessageError, ValueError):
    """A registry already knows another message type by this name."""


class VersionError(MessageError, ValueError):
    """Bytes of another version of a message type cannot be converted to this program's version."""
