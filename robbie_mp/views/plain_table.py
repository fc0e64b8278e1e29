"""A table with cells that cannot control a terminal."""

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from robbie_mp.visible_text import one_line


class PlainTable(Table):
    """A table without borders; a `str` cell always takes one line."""

    def __init__(self, *headings: str, header: bool = True):
        super().__init__(*headings, box=None, pad_edge=False, header_style="bold", show_header=header)

    def add_row(self, *cells: RenderableType | None, **options: object) -> None:
        """Add a row."""
        super().add_row(*(cell_of(cell) for cell in cells), **options)  # type: ignore[arg-type]


def cell_of(cell: RenderableType | None) -> RenderableType | None:
    """Return the content of a cell: a `str` becomes text on one line, everything else stays as it is."""
    return Text(one_line(cell)) if isinstance(cell, str) else cell
