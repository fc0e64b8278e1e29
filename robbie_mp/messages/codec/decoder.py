"""Writes `decode`."""

from __future__ import annotations

from collections.abc import Sequence
from pickle import PickleBuffer
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages.codec.encoder import CDR_LITTLE_ENDIAN
from robbie_mp.messages.codec.placement import Placement
from robbie_mp.messages.codec.plan import (
    ROOT,
    Encapsulation,
    FixedNumbers,
    Length,
    Loop,
    NumbersBody,
    Plan,
    Run,
    RunItem,
    Scalar,
    Structure,
    TextBody,
    Value,
)
from robbie_mp.messages.codec.source import Source
from robbie_mp.messages.codec.step_writer import StepWriter
from robbie_mp.messages.field_types import MessageLayout, Nested, Numbers, Primitive, Text, natural_default

MAX_TRAILING_BYTES = 3  # some writers pad a message to a multiple of four


def write_decoder(source: Source, plan: Plan, layout: MessageLayout) -> None:
    """Append the function `decode(buffer)`.

    The lines expect a name `_locate_failure`: given buffer and error it returns the error to raise.
    """
    _DecoderWriter(source).write(plan, layout)


def pinned(buffer: Any) -> memoryview:
    """Return the bytes of `buffer` so that every view of them keeps `buffer` itself alive.

    A memoryview of a memoryview refers to the exporter at the end of the chain, not to the memoryview in
    between, and numpy creates one for every array. A PickleBuffer between them refers to `buffer`.
    """
    return PickleBuffer(buffer).raw()


def read_truths(data: memoryview, _dtype: object, count: int, offset: int) -> NDArray[np.bool_]:
    """Return `count` truth values: a view; a copy if a byte is neither 0 nor 1, which numpy cannot hold."""
    octets = np.frombuffer(data, np.uint8, count, offset)
    return octets.view(np.bool_) if octets.max() <= 1 else octets != 0


class _DecoderWriter(StepWriter):
    def write(self, plan: Plan, layout: MessageLayout) -> None:
        line, block = self.source.line, self.source.block
        with block("def decode(_buffer):"):
            with block("try:"):
                line(f"_data = {self._access(plan, layout)}")
                line("_end = _len(_data)")
                self._body(plan)
                with block(f"if _end - {self.cursor.expression} > {MAX_TRAILING_BYTES}:"):
                    line('raise _ValueError("bytes behind the last field")')
                self._build(Structure(ROOT, Nested(layout)))
                line("return self")
            with block("except _Exception as _error:"):
                line("raise _locate_failure(_buffer, _error) from _error")

    def _access(self, plan: Plan, layout: MessageLayout) -> str:
        """Return the expression for the bytes, in the form that is fastest for this type."""
        if layout.has_views:
            return f"{self.source.name('_pinned', pinned)}(_buffer)"
        # One run needs one unpack, which takes any buffer; strings are cut faster out of bytes.
        return "_buffer" if len(plan.steps) == 1 else "_bytes(_buffer)"

    def _body(self, plan: Plan) -> None:
        self.steps(plan)
        for structure in reversed(plan.structures):
            self._build(structure)

    def _build(self, structure: Structure) -> None:
        """Append code that creates a message from the variables of its fields.

        The message is filled while it has a mutable class, then gets its final, immutable class.
        """
        name, layout = structure.value.variable, structure.type.layout
        blank = self.source.name(f"_Blank{layout.final.__name__}", layout.blank)
        final = self.source.name(f"_{layout.final.__name__}", layout.final)
        self.source.line(f"{name} = {blank}()")
        for field in layout.fields:
            member = structure.value.member(field.name)
            self.source.line(f"{name}.{field.name} = {member.variable}")
        self.source.line(f"{name}.__class__ = {final}")

    def run(self, run: Run, placements: dict[int, Placement]) -> None:
        targets = [target for target in map(_unpacked, run.items) if target]
        assignment = f"[{', '.join(targets)}] = " if targets else ""
        arrays = [item for item in run.items if isinstance(item, FixedNumbers)]
        start = self.cursor.expression
        if len(placements) == 1:
            (placement,) = placements.values()
            unpack = self.source.name("_unpack", placement.unpacking.unpack_from)
            self.source.line(f"{assignment}{unpack}(_data, {start})  # {placement.unpacking.format}")
            self._fixed_arrays(arrays, [f"{start} + {offset}" for offset in placement.array_offsets])
            self.cursor.advance(placement.size)
        else:
            offsets = [f"_offset_{number}" for number in range(len(arrays))]
            table = self.table(
                "_unpacks", placements, lambda at: (at.unpacking.unpack_from, at.size, *at.array_offsets)
            )
            self.source.line(f"{', '.join(('_unpack_here', '_size', *offsets))} = {table}[_i & 7]")
            self.source.line(f"{assignment}_unpack_here(_data, _i)")
            self._fixed_arrays(arrays, [f"_i + {offset}" for offset in offsets])
            self.cursor.advance_by_table(placements, "_size")
        for item in run.items:
            self._check(item)

    def _fixed_arrays(self, arrays: Sequence[FixedNumbers], positions: Sequence[str]) -> None:
        for item, position in zip(arrays, positions, strict=True):
            self._read_array(item.value, item.primitive, str(item.type.length), position)

    def _check(self, item: RunItem) -> None:
        """Append the checks of the values just unpacked; a failure is located later."""
        match item:
            case Encapsulation():
                condition = f"_encapsulation & 0xFFFF != 0x{CDR_LITTLE_ENDIAN:04x}"
            case Length() if item.type.max_length is not None:
                limit = item.type.max_length + isinstance(item.type, Text)  # the NUL of a text counts
                condition = f"{item.value.length} > {limit}"
            case _:
                return
        with self.source.block(f"if {condition}:"):
            self.source.line("raise _ValueError")

    def text(self, value: Value) -> None:
        start = self.cursor.expression
        self.source.line(f"_stop = {start} + {value.length}")
        with self.source.block("if _data[_stop - 1]:"):  # an index beyond the end raises too
            self.source.line('raise _ValueError("no NUL at the end")')
        self.source.line(f'{value.variable} = _str(_data[{start}:_stop - 1], "utf-8")')
        self.cursor.move_past_text("_stop")

    def numbers(self, step: NumbersBody) -> None:
        element, value = step.element, step.value
        empty = self.source.name(f"_no_{element}", natural_default(Numbers(element)))
        self.cursor.materialise()
        with self.source.block(f"if {value.length}:"):
            self.cursor.align_numbers(element.size)
            self._read_array(value, element, value.length, "_i")
            self.source.line(f"_i += {value.length} * {element.size}")
        with self.source.block("else:"):
            self.source.line(f"{value.variable} = {empty}")
        self.cursor.move_past_numbers(element.size)

    def _read_array(self, value: Value, element: Primitive, length: str, position: str) -> None:
        dtype = self.source.name(f"_{element}", element.dtype)
        reader = self.source.name(
            *(("_read_truths", read_truths) if element.name == "bool" else ("_frombuffer", np.frombuffer))
        )
        self.source.line(f"{value.variable} = {reader}(_data, {dtype}, {length}, {position})")

    def loop(self, loop: Loop) -> None:
        value, item = loop.value, loop.value.item.variable
        length = value.length if loop.length is None else str(loop.length)
        start = self.cursor.expression
        with self.source.block(f"if {length} * {smallest_size(loop.body)} > _end - {start}:"):
            self.source.line('raise _ValueError("too many elements")')
        self.source.line(f"{value.variable} = []")
        with self.cursor.loop(loop), self.source.block(f"for _ in _range({length}):"):
            self._body(loop.body)
            self.source.line(f"{value.variable}.append({item})")


def smallest_size(plan: Plan) -> int:
    """Return the bytes that the steps take at least."""
    size = 0
    for step in plan.steps:
        match step:
            case Run():
                size += sum(i.size if isinstance(i, FixedNumbers) else i.primitive.size for i in step.items)
            case Loop():
                size += (step.length or 0) * smallest_size(step.body)
            case TextBody() | NumbersBody():
                pass
    return size


def _unpacked(item: RunItem) -> str:
    """Return the variable for what `unpack_from` yields for an item; "" if it yields nothing."""
    match item:
        case Encapsulation():
            return "_encapsulation"
        case Scalar():
            return item.value.variable
        case Length():
            return item.value.length
        case _:
            return ""
