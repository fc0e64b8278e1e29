"""Converts encoded messages to ROS 1's serialisation and back, with code that is generated for each type.

Both are the same values in the same order. ROS 1 has neither encapsulation nor alignment, its strings end
without a NUL, its headers begin with a sequence number, and its empty messages are empty.

Source: https://wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes and
https://wiki.ros.org/ROS/Technical%20Overview#Message_serialization_and_msg_MD5_sums
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from functools import cache, partial
from struct import Struct
from typing import TYPE_CHECKING, NamedTuple, cast

from robbie_mp.base.errors import RobbieError
from robbie_mp.connect.ros1.definitions import HEADER, definition, md5, ros1_name
from robbie_mp.messages import DecodeError, Message
from robbie_mp.messages.codec.decoder import MAX_TRAILING_BYTES
from robbie_mp.messages.codec.encoder import CDR_LITTLE_ENDIAN
from robbie_mp.messages.codec.placement import LARGEST_ALIGNMENT, Placement, padding
from robbie_mp.messages.codec.plan import (
    ROOT,
    Encapsulation,
    Filler,
    FixedNumbers,
    Length,
    Loop,
    NumbersBody,
    Plan,
    Run,
    RunItem,
    Value,
    plan_message,
)
from robbie_mp.messages.codec.source import Source
from robbie_mp.messages.codec.step_writer import StepWriter
from robbie_mp.messages.field_types import Text
from robbie_mp.messages.message import fields_of

if TYPE_CHECKING:
    from typing_extensions import Buffer

_EXACT = {"f": "I", "d": "Q", "?": "B"}
"""Codes of the struct module that keep every bit, also of a NaN."""


class ConversionError(RobbieError, ValueError):
    """Bytes are not a message of the type that they should be."""


class Ros1Type(NamedTuple):
    """A message type as ROS 1 knows it.

        scan = ros1_type(LaserScan)
        assert scan.from_ros1(scan.to_ros1(LaserScan().encode())) == LaserScan().encode()

    Attributes:
        name: its name in ROS 1, such as `sensor_msgs/LaserScan`.
        md5: the sum by which nodes compare their definitions.
        definition: its text, with the texts of the types in it.
        message_type: its class.
    """

    name: str
    md5: str
    definition: str
    message_type: type[Message]

    def to_ros1(self, data: Buffer, sequence: int = 0) -> bytes:
        """Return ROS 1's serialisation of an encoded message.

        Args:
            data: the encoded message.
            sequence: the number in the message's header, if it has one; headers deeper inside get 0.

        Raises:
            ConversionError: the bytes do not encode a message of this type.
        """
        return _converter(self.message_type, _ToRos1)(data, sequence)

    def from_ros1(self, data: Buffer) -> bytes:
        """Return the encoding of a message that ROS 1 has serialised; a module can decode it.

        Raises:
            ConversionError: the bytes are no message of this type.
        """
        encoded = _converter(self.message_type, _FromRos1)(data, 0)
        try:
            self.message_type.decode(encoded)
        except DecodeError as error:
            raise ConversionError(str(error)) from None
        return encoded


@cache
def ros1_type(message_type: type[Message]) -> Ros1Type:
    """Return a message type as ROS 1 knows it."""
    name = ros1_name(message_type.type_name)
    return Ros1Type(name, md5(message_type), definition(message_type), message_type)


Converter = Callable[["Buffer", int], bytes]


@cache
def _converter(message_type: type[Message], writer: type[_Writer]) -> Converter:
    source = Source()
    source.name("_failure", ConversionError)
    source.name("_explain", partial(_explain, ros1_name(message_type.type_name)))
    plan = plan_message(fields_of(message_type))
    writer(source, set(_headers(message_type, plan)), message_type).write(plan)
    made = source.compile(f"<{writer.__name__} of {message_type.type_name} version {message_type.version}>")
    return cast("Converter", made["convert"])


def _explain(name: str, data: Buffer, error: Exception) -> str:
    return f"{len(memoryview(data))} bytes are no {name} message: {error}"


def _headers(message_type: type[Message], plan: Plan) -> Iterator[str]:
    """Return the variable of the first field of each header in a message."""
    if message_type.type_name == HEADER:
        yield _first(ROOT)
    yield from _nested_headers(plan)


def _nested_headers(plan: Plan) -> Iterator[str]:
    for structure in plan.structures:
        if structure.type.layout.type_name == HEADER:
            yield _first(structure.value)
    for step in plan.steps:
        if isinstance(step, Loop):
            yield from _nested_headers(step.body)


def _first(header: Value) -> str:
    return header.member("stamp").member("sec").variable


class _Writer(StepWriter):
    """Appends the function `convert(_buffer, _sequence)`.

    The position in the encoding is the cursor's. `_j` is the position in what ROS 1 has serialised.
    """

    def __init__(self, source: Source, headers: set[str], message_type: type[Message]):
        super().__init__(source)
        self._headers = headers
        own = ROOT if message_type.type_name == HEADER else ROOT.member("header")
        self._outermost = _first(own)

    def write(self, plan: Plan) -> None:
        line, block = self.source.line, self.source.block
        with block("def convert(_buffer, _sequence):"):
            with block("try:"):
                line('_data = _memoryview(_buffer).cast("B")')
                line("_end = _len(_data)")
                line("_parts = []")
                line("_append = _parts.append")
                self.body(plan)
                line('return b"".join(_parts)')
            with block("except _Exception as _error:"):
                line("raise _failure(_explain(_buffer, _error)) from None")

    @abstractmethod
    def body(self, plan: Plan) -> None:
        """Append the code for all steps, and the check that nothing is left."""

    def encoded(self, run: Run, start: int) -> Struct:
        """Return the struct of a run in an encoding, from a position on."""
        position, format_ = start, "<"
        for item in run.items:
            gap = padding(position, item.primitive.size)
            code, size = _code(item)
            format_ += "x" * gap + code
            position += gap + size
        return Struct(format_)

    def serialised(self, run: Run, *, skip_sequence: bool) -> Struct:
        """Return the struct of a run in ROS 1."""
        format_ = "<"
        for item in run.items:
            if self.begins_header(item):
                format_ += "4x" if skip_sequence else "I"
            if not isinstance(item, Encapsulation | Filler):
                format_ += _code(item)[0]
        return Struct(format_)

    def begins_header(self, item: RunItem) -> bool:
        """Whether a sequence number comes before an item in ROS 1."""
        return not isinstance(item, Encapsulation | Filler | Length) and item.value.variable in self._headers

    def structs(self, run: Run, placements: dict[int, Placement], method: str) -> str:
        """Return the expression for `pack` or `unpack_from` of a run in the encoding, at the cursor.

        Where the position is not known, a line that sets `_here` and `_size` comes before.
        """
        made = {start: getattr(self.encoded(run, start), method) for start in placements}
        if len(made) == 1:
            return self.source.name("_encoded", *made.values())
        entries = tuple(
            (made[start], placements[start].size) if start in made else None
            for start in range(LARGEST_ALIGNMENT)
        )
        table = self.source.name("_encodings", entries)
        self.source.line(f"_here, _size = {table}[{self.cursor.expression} & 7]")
        return "_here"

    def advance(self, placements: dict[int, Placement]) -> None:
        """Move the cursor past a run."""
        if len(placements) == 1:
            self.cursor.advance(next(iter(placements.values())).size)
        else:
            self.cursor.advance_by_table(placements, "_size")

    def loop(self, loop: Loop) -> None:
        count = f"{loop.value.length}" if loop.length is None else str(loop.length)
        if loop.length is None:
            with self.source.block(f"if {count} > _end:"):
                self.source.line('raise _ValueError("a list is longer than the message")')
        with self.cursor.loop(loop), self.source.block(f"for _ in _range({count}):"):
            self.steps(loop.body)

    def cut(self, start: str, stop: str) -> None:
        """Append the line that passes bytes on."""
        with self.source.block("if _stop > _end:"):
            self.source.line('raise _ValueError("it ends too early")')
        self.source.line(f"_append(_data[{start}:{stop}])")


class _ToRos1(_Writer):
    def body(self, plan: Plan) -> None:
        self.steps(plan)
        with self.source.block(f"if _end - {self.cursor.expression} > {MAX_TRAILING_BYTES}:"):
            self.source.line('raise _ValueError("bytes behind the last field")')

    def run(self, run: Run, placements: dict[int, Placement]) -> None:
        unpack = self.structs(run, placements, "unpack_from")
        names = ", ".join(map(_variable, filter(_has_value, run.items)))
        call = f"{unpack}(_data, {self.cursor.expression})"
        self.source.line(f"[{names}] = {call}" if names else call)
        if any(isinstance(item, Encapsulation) for item in run.items):
            with self.source.block(f"if _encapsulation & 0xFFFF != 0x{CDR_LITTLE_ENDIAN:04x}:"):
                self.source.line('raise _ValueError("it does not begin with 00 01")')
        self.advance(placements)
        values = list(self._values(run))
        if values:
            pack = self.source.name("_pack", self.serialised(run, skip_sequence=False).pack)
            self.source.line(f"_append({pack}({', '.join(values)}))")

    def _values(self, run: Run) -> Iterator[str]:
        for item in run.items:
            if self.begins_header(item):
                yield "_sequence" if _variable(item) == self._outermost else "0"
            if isinstance(item, Length) and isinstance(item.type, Text):
                yield f"{_variable(item)} - 1"
            elif not isinstance(item, Encapsulation | Filler):
                yield _variable(item)

    def text(self, value: Value) -> None:
        start = self.cursor.expression
        self.source.line(f"_stop = {start} + {value.length}")
        self.cut(start, "_stop - 1")
        with self.source.block("if _data[_stop - 1]:"):
            self.source.line('raise _ValueError("no NUL at the end of a string")')
        self.cursor.move_past_text("_stop")

    def numbers(self, step: NumbersBody) -> None:
        self.cursor.materialise()
        with self.source.block(f"if {step.value.length}:"):
            self.cursor.align_numbers(step.element.size)
            self.source.line(f"_stop = _i + {step.value.length} * {step.element.size}")
            self.cut("_i", "_stop")
            self.source.line("_i = _stop")
        self.cursor.move_past_numbers(step.element.size)


class _FromRos1(_Writer):
    def body(self, plan: Plan) -> None:
        self.source.line("_j = 0")
        self.steps(plan)
        with self.source.block("if _j != _end:"):
            self.source.line('raise _ValueError("bytes behind the last field")')

    def run(self, run: Run, placements: dict[int, Placement]) -> None:
        struct = self.serialised(run, skip_sequence=True)
        items = [item for item in run.items if not isinstance(item, Encapsulation | Filler)]
        if struct.size:
            names = ", ".join(map(_variable, items))
            unpack = self.source.name("_unpack", struct.unpack_from)
            self.source.line(f"[{names}] = {unpack}(_data, _j)")
            self.source.line(f"_j += {struct.size}")
        pack = self.structs(run, placements, "pack")
        self.source.line(f"_append({pack}({', '.join(filter(None, map(_packed, run.items)))}))")
        self.advance(placements)

    def text(self, value: Value) -> None:
        self.source.line(f"_stop = _j + {value.length}")
        self.cut("_j", "_stop")
        with self.source.block("if 0 in _parts[-1]:"):
            self.source.line('raise _ValueError("a NUL within a string")')
        self.source.line(r'_append(b"\0")')
        self.source.line("_j = _stop")
        self.cursor.move_past_text(f"{self.cursor.expression} + {value.length} + 1")

    def numbers(self, step: NumbersBody) -> None:
        self.cursor.materialise()
        with self.source.block(f"if {step.value.length}:"):
            self.cursor.align_numbers(step.element.size, r'_append(b"\0\0\0\0")')
            self.source.line(f"_stop = _j + {step.value.length} * {step.element.size}")
            self.cut("_j", "_stop")
            self.source.line("_i += _stop - _j")
            self.source.line("_j = _stop")
        self.cursor.move_past_numbers(step.element.size)


def _code(item: RunItem) -> tuple[str, int]:
    """Return the code of an item in the struct module, and its size."""
    if isinstance(item, FixedNumbers):
        return f"{item.size}s", item.size
    if isinstance(item, Filler):
        return "x", 1
    return _EXACT.get(item.primitive.code, item.primitive.code), item.primitive.size


def _has_value(item: RunItem) -> bool:
    return not isinstance(item, Filler)


def _variable(item: RunItem) -> str:
    match item:
        case Encapsulation():
            return "_encapsulation"
        case Length():
            return item.value.length
        case Filler():
            return ""
        case _:
            return item.value.variable


def _packed(item: RunItem) -> str:
    """Return the value of an item in the encoding; "" for an item that only takes space."""
    if isinstance(item, Encapsulation):
        return f"0x{CDR_LITTLE_ENDIAN:04x}"
    is_text = isinstance(item, Length) and isinstance(item.type, Text)
    return f"{_variable(item)} + 1" if is_text else _variable(item)
