"""The encoding of a message type as a flat list of steps, from which its functions are written.

CDR does not mark nested messages, so their fields are listed flat. Consecutive items of fixed size form a
run, which one `struct.Struct` handles. A run ends where bytes of variable size follow, and contains their
length word.

Source of the encoding: OMG DDSI-RTPS 2.2, chapter 10, and OMG CORBA 3.0, section 15.3 (CDR).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from robbie_mp.messages.field_types import (
    Field,
    FieldType,
    Items,
    Nested,
    Numbers,
    Primitive,
    Text,
)

UINT8 = Primitive("uint8", "B", 1, 0)
UINT32 = Primitive("uint32", "I", 4, 0)
SEPARATOR = "__"  # joins names in variables; ROS allows no double underscore inside a field name


class Value(NamedTuple):
    """A value in a message, as the generated code refers to it.

    Attributes:
        variable: the local variable that holds it.
        source: the expression that reads it from the message.
    """

    variable: str
    source: str

    def member(self, name: str) -> Value:
        """Return the value of one of its fields."""
        prefix = "" if self.variable == ROOT.variable else self.variable + SEPARATOR
        return Value(prefix + name, f"{self.variable}.{name}")

    @property
    def length(self) -> str:
        """The variable for its number of elements, or of bytes for a text."""
        return f"{self.variable}{SEPARATOR}length"

    @property
    def item(self) -> Value:
        """The value of one of its elements in a loop."""
        name = f"{self.variable}{SEPARATOR}item"
        return Value(name, name)


ROOT = Value("self", "self")


class Scalar(NamedTuple):
    """A primitive in a run."""

    value: Value
    primitive: Primitive


class Length(NamedTuple):
    """The length word of the variable-size `value` of this type, in a run."""

    value: Value
    type: Text | Numbers | Items
    primitive: Primitive = UINT32


class FixedNumbers(NamedTuple):
    """All elements of a fixed array of primitives, in a run."""

    value: Value
    type: Numbers

    @property
    def primitive(self) -> Primitive:
        """The element type."""
        return self.type.element

    @property
    def size(self) -> int:
        """Bytes of all elements."""
        assert self.type.length is not None
        return self.type.length * self.type.element.size


class Encapsulation(NamedTuple):
    """The four bytes before the body that say how it is encoded."""

    primitive: Primitive = UINT32


class Filler(NamedTuple):
    """The byte of a message without fields (IDL forbids empty structures; ROS 2 inserts one byte)."""

    primitive: Primitive = UINT8


RunItem = Scalar | Length | FixedNumbers | Encapsulation | Filler


class Run(NamedTuple):
    """Consecutive items of fixed size."""

    items: tuple[RunItem, ...]


class TextBody(NamedTuple):
    """The bytes of a string and the NUL that ends it."""

    value: Value


class NumbersBody(NamedTuple):
    """The elements of a sequence of primitives."""

    value: Value
    element: Primitive


class Loop(NamedTuple):
    """The same steps for each element of a list; `length` is None for a sequence."""

    value: Value
    length: int | None
    body: Plan


Step = Run | TextBody | NumbersBody | Loop


class Structure(NamedTuple):
    """A message, the outermost or a nested one, whose fields the steps handle."""

    value: Value
    type: Nested


@dataclass
class Plan:
    """The steps for one message, or for one element of a list.

    Attributes:
        steps: what is on the wire, in order.
        structures: the messages involved, outer before inner.
        texts: the strings involved, which the encoder turns into bytes first.
        sequences: the arrays and lists of variable length involved.
    """

    steps: list[Step] = field(default_factory=list)
    structures: list[Structure] = field(default_factory=list)
    texts: list[Value] = field(default_factory=list)
    sequences: list[Value] = field(default_factory=list)

    def add_fixed(self, *items: RunItem) -> None:
        """Append to the run at the end, or begin one."""
        match self.steps:
            case [*_, Run() as last]:
                self.steps[-1] = Run((*last.items, *items))
            case _:
                self.steps.append(Run(items))

    def add_fields(self, owner: Value, fields: Sequence[Field]) -> None:
        """Append the steps for the fields of `owner`."""
        if not fields:
            self.add_fixed(Filler())
        for declared in fields:
            self.add(owner.member(declared.name), declared.type)

    def add(self, value: Value, kind: FieldType) -> None:
        """Append the steps for a value of this type."""
        match kind:
            case Primitive():
                self.add_fixed(Scalar(value, kind))
            case Text():
                self.texts.append(value)
                self.add_fixed(Length(value, kind))
                self.steps.append(TextBody(value))
            case Nested():
                self.structures.append(Structure(value, kind))
                self.add_fields(value, kind.layout.fields)
            case Numbers() if kind.length is not None:
                self.add_fixed(FixedNumbers(value, kind))
            case Numbers():
                self.sequences.append(value)
                self.add_fixed(Length(value, kind))
                self.steps.append(NumbersBody(value, kind.element))
            case Items():
                self.sequences.append(value)
                if kind.length is None:
                    self.add_fixed(Length(value, kind))
                body = Plan()
                body.add(value.item, kind.element)
                self.steps.append(Loop(value, kind.length, body))


def plan_message(fields: Sequence[Field]) -> Plan:
    """Return the steps for a whole message, its encapsulation first."""
    plan = Plan()
    plan.add_fixed(Encapsulation())
    plan.add_fields(ROOT, fields)
    return plan
