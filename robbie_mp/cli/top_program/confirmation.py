"""Asks for confirmation before a command acts on the robot."""

from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.screen import ModalScreen
from textual.widgets import Static

from robbie_mp.visible_text import one_line


class Confirmation(ModalScreen[bool]):
    """A question to be answered with y or n."""

    CSS = """
    Confirmation { align: center middle; }
    Confirmation > Static { width: auto; padding: 1 3; border: round $warning; background: $surface; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "dismiss(True)", "Yes"),
        Binding("n,escape,q", "dismiss(False)", "No"),
    ]

    def __init__(self, question: str):
        super().__init__()
        self.question = question

    def compose(self) -> ComposeResult:
        """Build the question."""
        yield Static(f"{one_line(self.question)}\n\ny: yes   n: no", markup=False)
