"""A table with cells that cannot control a terminal, and that fits into a narrow one."""

from dataclasses import replace
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.table import Column, Table
from rich.text import Text

from robbie_mp.base.visible_text import one_line

MIN_TEXT_COLUMNS = 12
"""Narrowest width of a text that shrinks, in columns of the terminal."""
GAP = 2
"""Columns of the terminal between two columns of the table."""
UNBOUNDED_COLUMNS = 10_000


class PlainTable(Table):
    """A table without borders; a `str` cell always takes one line.

    On a terminal that is too narrow, texts that may shrink end with an ellipsis, and then whole columns are
    left out, in the order that `add_column` declares. A number is never cut.
    """

    def __init__(self, *headings: str, header: bool = True):
        super().__init__(*headings, box=None, pad_edge=False, header_style="bold", show_header=header)
        self._fits: dict[int, tuple[int, bool]] = {}
        """For columns by their index: the order in which they are left out, and whether they shrink."""

    def add_column(  # type: ignore[override]
        self, header: RenderableType = "", *, left_out: int = 0, shrinks: bool = False, **options: Any
    ) -> None:
        """Add a column.

        Args:
            header: the heading.
            left_out: the order in which columns are left out on a narrow terminal: 1 is the first; 0: never.
            shrinks: whether the texts may be shortened.
            options: those of rich's own method.
        """
        if left_out or shrinks:
            self._fits[len(self.columns)] = (left_out, shrinks)
        super().add_column(header, **options)

    def add_row(self, *cells: RenderableType | None, **options: object) -> None:
        """Add a row."""
        super().add_row(*(cell_of(cell) for cell in cells), **options)  # type: ignore[arg-type]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the columns for which there is room."""
        if not self._fits:
            yield from super().__rich_console__(console, options)
            return
        widths = [GAP + self._content_width(console, options, column) for column in self.columns]
        shown = self._shown(widths, options.max_width + GAP)
        fitted = _share(
            [widths[index] for index in shown],
            [self._fit(index)[1] for index in shown],
            options.max_width + GAP,
        )
        made = Table(box=None, padding=(0, GAP, 0, 0), header_style="bold", show_header=self.show_header)
        made.columns = [
            replace(self.columns[index], _index=place, width=width - GAP)
            for place, (index, width) in enumerate(zip(shown, fitted, strict=True))
        ]
        made.rows = self.rows
        yield from made.__rich_console__(console, options.update(width=sum(fitted)))

    def _content_width(self, console: Console, options: ConsoleOptions, column: Column) -> int:
        wide = options.update(width=UNBOUNDED_COLUMNS)
        texts = [*([column.header] if self.show_header else []), *column.cells]
        return max((Measurement.get(console, wide, text).maximum for text in texts), default=0)

    def _fit(self, index: int) -> tuple[int, bool]:
        return self._fits.get(index, (0, False))

    def _shown(self, widths: list[int], room: int) -> list[int]:
        """Return the indexes of the columns for which there is room."""
        shown = list(range(len(widths)))

        least = [
            min(width, MIN_TEXT_COLUMNS) if self._fit(index)[1] else width
            for index, width in enumerate(widths)
        ]
        droppable = sorted((index for index in shown if self._fit(index)[0]), key=self._fit)
        while droppable and sum(least[index] for index in shown) > room:
            shown.remove(droppable.pop(0))
        return shown


def _share(widths: list[int], shrinking: list[bool], room: int) -> list[int]:
    """Return the widths of columns; those that shrink share what the others leave, the short ones first."""
    left = room - sum(width for width, shrinks in zip(widths, shrinking, strict=True) if not shrinks)
    places = sorted((place for place, shrinks in enumerate(shrinking) if shrinks), key=widths.__getitem__)
    fitted = list(widths)
    for done, place in enumerate(places):
        fitted[place] = min(widths[place], max(MIN_TEXT_COLUMNS, left // (len(places) - done)))
        left -= fitted[place]
    return fitted


def cell_of(cell: RenderableType | None) -> RenderableType | None:
    """Return the content of a cell: a `str` becomes text on one line, everything else stays as it is."""
    return Text(one_line(cell)) if isinstance(cell, str) else cell
