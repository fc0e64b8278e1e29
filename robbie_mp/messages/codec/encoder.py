"""Writes `encode_into`, and the variant of it that leaves loaned arrays to be filled later."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from robbie_mp.messages.codec.placement import Placement
from robbie_mp.messages.codec.plan import (
    Encapsulation,
    FixedNumbers,
    Length,
    Loop,
    NumbersBody,
    Plan,
    Run,
    RunItem,
    Scalar,
    Value,
)
from robbie_mp.messages.codec.source import Source
from robbie_mp.messages.codec.step_writer import StepWriter

CDR_LITTLE_ENDIAN = 0x0100  # the bytes 00 01 00 00, read as a little-endian word


def write_encoder(source: Source, plan: Plan) -> None:
    """Append the function `encode_into(self, buffer, offset=0)`, which returns the size.

    The lines expect a name `_explain`: given message, buffer and error it returns the error to raise.
    """
    _EncoderWriter(source, ()).write("encode_into(self, _buffer, _offset=0)", plan)


def write_loan_encoder(source: Source, plan: Plan, loaned: Collection[str]) -> None:
    """Append `encode_around_loans(self, buffer, offset)`, which returns views for the fields in `loaned`.

    The elements of these fields, sequences of the outermost message, are skipped and not written.
    """
    source.name("_frombuffer", np.frombuffer)
    _EncoderWriter(source, loaned).write("encode_around_loans(self, _buffer, _offset)", plan)


class _EncoderWriter(StepWriter):
    def __init__(self, source: Source, loaned: Collection[str]):
        super().__init__(source)
        self._loaned = loaned

    def write(self, signature: str, plan: Plan) -> None:
        line, block = self.source.line, self.source.block
        with block(f"def {signature}:"):
            with block("if _offset or _type(_buffer) is not _memoryview:"):
                line("_buffer = _memoryview(_buffer)[_offset:]")
            with block("try:"):
                if self._loaned:
                    line("_loans = {}")
                self._body(plan)
                line("return _loans" if self._loaned else f"return {self.cursor.expression}")
            with block("except _Exception as _error:"):
                line("raise _explain(self, _buffer, _error) from _error")

    def _body(self, plan: Plan) -> None:
        for structure in plan.structures:
            self.load(structure.value)
        for text in plan.texts:
            self.source.line(f'{text.variable} = {text.source}.encode() + b"\\0"')
        for sequence in plan.sequences:
            self.load(sequence)
        self.steps(plan)

    def run(self, run: Run, placements: dict[int, Placement]) -> None:
        values = ", ".join(filter(None, map(_packed, run.items)))
        if len(placements) == 1:
            (placement,) = placements.values()
            pack = self.source.name("_pack", placement.packing.pack_into)
            self.source.line(
                f"{pack}(_buffer, {self.cursor.expression}, {values})  # {placement.packing.format}"
            )
            self.cursor.advance(placement.size)
        else:
            table = self.table("_packs", placements, lambda at: (at.packing.pack_into, at.size))
            self.source.line(f"_pack_here, _size = {table}[_i & 7]")
            self.source.line(f"_pack_here(_buffer, _i, {values})")
            self.cursor.advance_by_table(placements, "_size")

    def text(self, value: Value) -> None:
        start = self.cursor.expression
        self.source.line(f"_stop = {start} + _len({value.variable})")
        self.source.line(f"_buffer[{start}:_stop] = {value.variable}")
        self.cursor.move_past_text("_stop")

    def numbers(self, step: NumbersBody) -> None:
        name, element = step.value.variable, step.element
        self.cursor.materialise()
        if name in self._loaned:
            dtype = self.source.name(f"_{element}", element.dtype)
            # Writable like any loan, so that the caller need not treat an empty array differently.
            self.source.line(f'_loans["{name}"] = {self.source.name("_empty", np.empty)}(0, {dtype})')
        with self.source.block(f"if _len({name}):"):
            self.cursor.align_numbers(element.size, '_buffer[_i:_i + 4] = b"\\0\\0\\0\\0"')
            self.source.line(f"_stop = _i + _len({name}) * {element.size}")
            if name in self._loaned:
                self.source.line(f'_loans["{name}"] = _frombuffer(_buffer, {dtype}, _len({name}), _i)')
            else:
                octets = name if element.code == "B" else f'{name}.data.cast("B")'
                self.source.line(f"_buffer[_i:_stop] = {octets}")
            self.source.line("_i = _stop")
        self.cursor.move_past_numbers(element.size)

    def loop(self, loop: Loop) -> None:
        if loop.length is not None:
            with self.source.block(f"if _len({loop.value.variable}) != {loop.length}:"):
                self.source.line('raise _ValueError("wrong number of elements")')
        with (
            self.cursor.loop(loop),
            self.source.block(f"for {loop.value.item.variable} in {loop.value.variable}:"),
        ):
            self._body(loop.body)


def _packed(item: RunItem) -> str:
    """Return the argument of `pack_into` for an item; "" for an item that only takes space."""
    match item:
        case Encapsulation():
            return f"0x{CDR_LITTLE_ENDIAN:04x}"
        case Scalar():
            return item.value.source
        case Length():
            return f"_len({item.value.variable})"
        case FixedNumbers():
            return f"{item.value.source}.tobytes()"
        case _:
            return ""
