"""The last filter for everything that the program draws."""

from rich.segment import Segment
from textual.color import Color
from textual.filter import LineFilter

from robbie_mp.visible_text import without_controls


class PlainFilter(LineFilter):
    """Removes characters that a terminal would obey.

    Tables and lines make such characters visible when they take in a text. This filter catches any that they
    missed. It cannot show them, because every character already has its place on the screen.
    """

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the segments without control characters."""
        return [
            segment if segment.control else Segment(without_controls(segment.text), segment.style)
            for segment in segments
        ]
