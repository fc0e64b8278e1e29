"""The last place through which all goes that the program draws."""

from rich.segment import Segment
from textual.color import Color
from textual.filter import LineFilter

from robbie_mp.visible_text import without_controls


class PlainFilter(LineFilter):
    """Takes out what a terminal would obey.

    Texts are made visible where they are put into tables and lines. What was forgotten there must do no harm
    either; here it is too late to show it, for every character has its place on the screen already.
    """

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the segments without control characters."""
        return [
            segment if segment.control else Segment(without_controls(segment.text), segment.style)
            for segment in segments
        ]
