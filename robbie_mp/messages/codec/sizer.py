"""Writes `encoded_size`."""

from __future__ import annotations

from robbie_mp.messages.codec.placement import Placement
from robbie_mp.messages.codec.plan import Loop, NumbersBody, Plan, Run, Value
from robbie_mp.messages.codec.source import Source
from robbie_mp.messages.codec.step_writer import StepWriter


def write_sizer(source: Source, plan: Plan) -> None:
    """Append the function `encoded_size(self)`.

    The lines expect a name `_explain`, as those of the encoder.
    """
    _SizerWriter(source).write(plan)


class _SizerWriter(StepWriter):
    def write(self, plan: Plan) -> None:
        line, block = self.source.line, self.source.block
        with block("def encoded_size(self):"):
            if not (plan.texts or plan.sequences):
                self.steps(plan)
                line(f"return {self.cursor.expression}")
                return
            with block("try:"):
                self._body(plan)
                line(f"return {self.cursor.expression}")
            with block("except _Exception as _error:"):
                line("raise _explain(self, None, _error) from _error")

    def _body(self, plan: Plan) -> None:
        variable = (*plan.texts, *plan.sequences)
        for structure in plan.structures:
            if any(value.variable.startswith(structure.value.variable) for value in variable):
                self.load(structure.value)
        for value in variable:
            self.load(value)
        self.steps(plan)

    def run(self, run: Run, placements: dict[int, Placement]) -> None:
        sizes = {placement.size for placement in placements.values()}
        if len(sizes) == 1:
            self.cursor.advance(sizes.pop())
        else:
            table = self.table("_sizes", placements, lambda at: at.size)
            self.cursor.advance_by_table(placements, f"{table}[_i & 7]")

    def text(self, value: Value) -> None:
        name = value.variable
        octets = f"(_len({name}) if {name}.isascii() else _len({name}.encode()))"
        self.cursor.move_past_text(f"{self.cursor.expression} + {octets} + 1")

    def numbers(self, step: NumbersBody) -> None:
        name, size = step.value.variable, step.element.size
        self.cursor.materialise()
        if size <= 4:
            self.source.line(f"_i += _len({name}) * {size}")
        else:
            with self.source.block(f"if _len({name}):"):
                self.cursor.align_numbers(size)
                self.source.line(f"_i += _len({name}) * {size}")
        self.cursor.move_past_numbers(size)

    def loop(self, loop: Loop) -> None:
        with (
            self.cursor.loop(loop),
            self.source.block(f"for {loop.value.item.variable} in {loop.value.variable}:"),
        ):
            self._body(loop.body)
