"""The base class of messages: immutable typed data with an encoding."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Mapping
from functools import partial
from inspect import Parameter, Signature
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, TypeVar, cast

import numpy as np
from typing_extensions import Self, dataclass_transform

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.bus._hot.choice import native
from robbie_mp.messages.codec.functions import FUNCTIONS
from robbie_mp.messages.codec.table import tabulate
from robbie_mp.messages.declaration import Constant, Upgrade, read_declaration, read_fields
from robbie_mp.messages.errors import DeclarationError, ImmutableMessage, NotAMessage
from robbie_mp.messages.field_types import Field, Items, MessageLayout, Nested, Numbers, natural_default
from robbie_mp.messages.text import represent

if TYPE_CHECKING:
    from typing_extensions import Buffer

    from robbie_mp.bus._hot.native import MessageCodec
    from robbie_mp.messages.flaws import Flaw

_NATIVE = native()
"""Chosen here, because classes get their functions when they are made, and most are made by imports."""


@dataclass_transform(kw_only_default=True, frozen_default=True)
class MessageType(type):
    """Creates a message class from a class body: fields become slots, and the codec is made from them.

    Args:
        class_name: the name of the class.
        bases: `Message`, or none for `Message` itself.
        namespace: the class body.
        name: its ROS name, such as `sensor_msgs/msg/LaserScan`.
        version: version number from 1; raise it whenever you change the fields.
        upgrades: for each older version, the step to the next one.
        template: whether the class is no message type, but gives its fields to the message types that
            inherit from it, in front of theirs; see `robbie_mp.messages.calls`.
        latched: whether the core keeps the newest message of each topic for later subscribers; `publish` can
            ask for it too. This is no part of the wire format.
        checked: whether `publish` refuses messages of this type that are not well formed, as with all that
            moves a robot; this costs some time. Subscribers get no message that is not, whatever its type.

    Raises:
        DeclarationError: the class cannot be a message type; the text says why.
    """

    def __new__(
        metacls,
        class_name: str,
        bases: tuple[type, ...],
        namespace: dict[str, Any],
        /,
        *,
        name: str = "",
        version: int = 1,
        upgrades: Mapping[int, Upgrade] | None = None,
        template: bool = False,
        latched: bool = False,
        checked: bool = False,
    ) -> MessageType:
        """Create the class."""
        if not bases:
            return super().__new__(metacls, class_name, bases, namespace)
        if template:
            fields = read_fields(class_name, namespace)
            body = {key: value for key, value in namespace.items() if key not in {one.name for one in fields}}
            return super().__new__(metacls, class_name, bases, {**body, "__slots__": (), "_leading": fields})
        leading: tuple[Field, ...] | None = getattr(bases[0], "_leading", None)
        is_from_template = len(bases) == 1 and leading is not None and "_leading" in vars(bases[0])
        if not is_from_template and bases != (Message,):
            raise DeclarationError(
                f"{class_name}: messages do not inherit from messages; nest one as a field"
            )
        if version < 1:
            raise DeclarationError(f"{class_name}: version={version}; versions are counted from 1")
        declaration = read_declaration(class_name, name, namespace, leading or ())
        slots = tuple(field.name for field in declaration.fields)
        blank = type(f"{class_name}InTheMaking", (), {"__slots__": slots})
        body = {key: value for key, value in namespace.items() if key not in slots}
        body |= {
            "__slots__": (),
            "type_name": name,
            "version": version,
            "is_latched": latched,
            "is_checked": checked,
            "_ruled": tuple(
                (field.name, isinstance(field.type, Items))
                for field in declaration.fields
                if _has_rules(field)
            ),
            "_constants": declaration.constants,
            "_upgrades": dict(upgrades or {}),
        }
        made: Any = super().__new__(metacls, class_name, (*bases, blank), body)
        made._layout = MessageLayout(name, version, declaration.fields, blank, made)
        made.has_views = made._layout.has_views
        made.has_rules = "flaw" in namespace or bool(made._ruled)
        if _NATIVE is not None:
            codec = _NATIVE.MessageCodec(made, partial(tabulate, made._layout), partial(_make, made))
            for function in (*FUNCTIONS, "forget_arrays"):
                if function not in namespace and (function != "__new__" or "__init__" not in namespace):
                    codec.install(function)
        return cast("MessageType", made)

    @property
    def __signature__(cls) -> Signature:
        """The constructor's parameters, for `help` and `inspect.signature`, with either form of the codec."""
        if cls is Message:
            raise AttributeError("any fields")
        return Signature(
            [
                Parameter(field.name, Parameter.KEYWORD_ONLY, default=field.default)
                for field in fields_of(cast("type[Message]", cls))
            ]
        )


class Message(metaclass=MessageType):
    """Immutable typed data with a version; the only way modules talk.

    A subclass declares the fields:

        class LaserScan(Message, name="sensor_msgs/msg/LaserScan", version=1):
            header: Header
            angle_min: float32  # rad
            ranges: Array[float32]  # (N,) m

    Its constructor takes them as keyword arguments. A field that you leave out is 0, False, "", empty, or has
    its declared default. Arrays are not copied: do not change an array after you gave it to a message.

    Raises:
        FieldError: a value does not fit its field.
    """

    __slots__ = ()

    type_name: ClassVar[str]
    """Its ROS name, such as `sensor_msgs/msg/LaserScan`."""
    version: ClassVar[int]
    """Version number from 1; it grows whenever the fields change."""
    is_latched: ClassVar[bool]
    """Whether the core keeps the newest message of each topic for later subscribers."""
    is_checked: ClassVar[bool]
    """Whether `publish` refuses a message that is not well formed."""
    has_rules: ClassVar[bool]
    """Whether a message may be ill-formed, by its own rules or those of messages in it; see `flaw`."""

    has_views: ClassVar[bool]
    """Whether a decoded message may hold arrays that are views of the buffer it was decoded from."""

    _layout: ClassVar[MessageLayout]
    _leading: ClassVar[tuple[Field, ...]]
    """The fields of a template."""
    _ruled: ClassVar[tuple[tuple[str, bool], ...]]
    """The fields with messages that have rules, and whether each is a list of them."""
    _constants: ClassVar[tuple[Constant, ...]]
    _upgrades: ClassVar[dict[int, Upgrade]]
    _codec: ClassVar[MessageCodec | None] = None
    """Does in C what the functions of `robbie_mp.messages.codec` do, if C is used."""

    # Four functions are made for each class at their first call, by these functions, unless C does them.

    def __new__(cls, /, **fields: Any) -> Self:
        """Create a message."""
        made: Self = _install(cls, "__new__")(cls, **fields)
        return made

    def encoded_size(self) -> int:
        """Return the size of the encoding in bytes, with the 4 bytes of the encapsulation header."""
        size: int = _install(type(self), "encoded_size")(self)
        return size

    def encode_into(self, buffer: memoryview, offset: int = 0) -> int:
        """Write the encoding (XCDR1, little endian) into a buffer.

        Args:
            buffer: writable bytes. Arrays are aligned if the encoding begins at a multiple of 8, plus 4.
            offset: where in the buffer the encoding begins.

        Returns:
            The size of the encoding in bytes.

        Raises:
            BufferTooSmall: the message does not fit.
            FieldError: a list or array was changed after the message was created, and no longer fits.
        """
        size: int = _install(type(self), "encode_into")(self, buffer, offset)
        return size

    def encode(self) -> bytes:
        """Return the encoding (XCDR1, little endian)."""
        buffer = bytearray(self.encoded_size())
        self.encode_into(memoryview(buffer))
        return bytes(buffer)

    @classmethod
    def decode(cls, buffer: Buffer) -> Self:
        """Decode a message.

        Its arrays are views of the buffer, read-only if the buffer is; each keeps the object `buffer` alive.

        Args:
            buffer: the encoding with its 4 bytes of encapsulation.

        Raises:
            DecodeError: the bytes do not encode a message of this type.
        """
        message: Self = _install(cls, "decode")(buffer)
        return message

    def flaw(self) -> Flaw | None:
        """Return what is wrong with the values of this message, apart from those of messages nested in it.

        A type whose values must fit together overrides this; see `robbie_mp.messages.well_formed`.
        """
        return None

    def forget_arrays(self) -> None:
        """Replace the message's arrays (not those of nested messages) by their defaults.

        Only for the code that lent their memory and takes it back; no other code may see a message change.
        """
        for field in fields_of(type(self)):
            if isinstance(field.type, Numbers):
                object.__setattr__(self, field.name, natural_default(field.type))

    def __setattr__(self, name: str, value: object) -> NoReturn:
        known = [field.name for field in fields_of(type(self))]
        if name not in known:
            near = did_you_mean(name, known) or f"; its fields are {', '.join(known)}"
            raise ImmutableMessage(f"{type(self).__name__} is immutable, and has no field {name!r}{near}")
        raise ImmutableMessage(
            f"{type(self).__name__} is immutable; create a copy with another {name}: see replace()"
        )

    def __delattr__(self, name: str) -> NoReturn:
        raise ImmutableMessage(f"{type(self).__name__} is immutable")

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(
            np.array_equal(mine, theirs) if isinstance(mine, np.ndarray) else mine == theirs
            for mine, theirs in (
                (getattr(self, field.name), getattr(other, field.name)) for field in fields_of(type(self))
            )
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return represent(
            type(self).__name__, ((field.name, getattr(self, field.name)) for field in fields_of(type(self)))
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return _decode_as, (type(self), self.encode())


def _decode_as(message_type: type[Message], data: bytes) -> Message:
    return message_type.decode(data)


def _install(message_type: type[Message], name: str) -> Callable[..., Any]:
    """Make one of the four functions of a message class, install it in the class, and return it."""
    made = _make(message_type, name)
    setattr(message_type, name, staticmethod(made) if name in ("__new__", "decode") else made)
    return made


def _make(message_type: type[Message], name: str) -> Callable[..., Any]:
    """Make one of the four functions of a message class, and return it; others it inherits."""
    if name not in FUNCTIONS:
        return cast("Callable[..., Any]", getattr(Message, name))
    made = FUNCTIONS[name](message_type._layout)
    made.__doc__ = getattr(Message, name).__doc__
    made.__qualname__ = f"{message_type.__qualname__}.{name}"
    return made


def _has_rules(field: Field) -> bool:
    """Whether a field holds messages that may be ill-formed."""
    kind = field.type.element if isinstance(field.type, Items) else field.type
    return isinstance(kind, Nested) and kind.message.has_rules


def fields_of(message_type: type[Message]) -> tuple[Field, ...]:
    """Return the fields of a message type, in the order of the encoding."""
    return message_type._layout.fields


def nested(message_type: type[Message]) -> Nested:
    """Return the field type for a message nested in another."""
    return Nested(message_type._layout)


_Message = TypeVar("_Message", bound=Message)


def replace(message: _Message, **changes: Any) -> _Message:
    """Return a copy of a message with some fields changed.

    Args:
        message: the original; it does not change.
        changes: the new values of fields, by name.

    Raises:
        FieldError: a value does not fit its field.
    """
    fields = {field.name: getattr(message, field.name) for field in fields_of(type(message))}
    return type(message)(**fields | changes)


def check_message(value: object, verb: str) -> None:
    """Check that a value is a message.

    Args:
        value: what should be one.
        verb: what the caller wants to do with it, such as "publish".

    Raises:
        NotAMessage: it is something else.
    """
    if isinstance(value, Message):
        return
    if isinstance(value, MessageType):
        got = f"the class itself; create a message: {verb}({value.__name__}(...))"
    elif isinstance(value, Mapping):
        got = f"{reprlib.repr(value)} (dict); from_dict(LaserScan, …) makes a message of a dict"
    else:
        got = f"{reprlib.repr(value)} ({type(value).__name__})"
    raise NotAMessage(f"{verb} wants a message, such as LaserScan(ranges=...); got {got}")


def check_message_type(value: object, verb: str) -> None:
    """Check that a value is a class of messages; arguments as for `check_message`.

    Raises:
        NotAMessage: it is something else.
    """
    if isinstance(value, MessageType) and value is not Message:
        return
    if isinstance(value, Message):
        got = f"a message; give its class: {type(value).__name__}"
    elif isinstance(value, str):
        encoded = ", or use subscribe_encoded" if verb == "subscribe" else ""
        got = f"{value!r:.60}; import the class{encoded}"
    else:
        got = f"{reprlib.repr(value)}"
    raise NotAMessage(f"{verb} wants a class of messages, such as LaserScan; got {got}")
