"""The common base of the writers of encoder, decoder and sizer, which process the same steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

from robbie_mp.messages.codec.cursor import Cursor
from robbie_mp.messages.codec.placement import LARGEST_ALIGNMENT, Placement
from robbie_mp.messages.codec.plan import Loop, NumbersBody, Plan, Run, TextBody, Value
from robbie_mp.messages.codec.source import Source


class StepWriter(ABC):
    """Appends the code for each step of a plan.

    Args:
        source: gets the code.
    """

    def __init__(self, source: Source):
        self.source = source
        self.cursor = Cursor(source)

    def steps(self, plan: Plan) -> None:
        """Append the code for all steps."""
        for step in plan.steps:
            match step:
                case Run():
                    self.run(step, self.cursor.placements(step))
                case TextBody():
                    self.text(step.value)
                case NumbersBody():
                    self.numbers(step)
                case Loop():
                    self.loop(step)

    @abstractmethod
    def run(self, run: Run, placements: dict[int, Placement]) -> None:
        """Append the code for a run, given its placement for each start position modulo 8."""

    @abstractmethod
    def text(self, value: Value) -> None:
        """Append the code for the bytes of a string."""

    @abstractmethod
    def numbers(self, step: NumbersBody) -> None:
        """Append the code for the elements of an array."""

    @abstractmethod
    def loop(self, loop: Loop) -> None:
        """Append the code for the elements of a list."""

    def table(self, name: str, placements: dict[int, Placement], entry: Callable[[Placement], object]) -> str:
        """Return the name of a tuple that has the entry for each possible position modulo 8."""
        entries = [
            entry(placements[start]) if start in placements else None for start in range(LARGEST_ALIGNMENT)
        ]
        return self.source.name(name, tuple(entries))

    def load(self, value: Value) -> None:
        """Append the line that reads a value into its variable."""
        if value.variable != value.source:
            self.source.line(f"{value.variable} = {value.source}")
