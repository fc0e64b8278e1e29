"""A sortable, filterable table of figures that keeps its position while the figures change."""

from collections.abc import Callable, Sequence
from typing import ClassVar, Generic, Protocol, TypeVar

from rich.text import Text
from textual.binding import Binding, BindingType
from textual.widgets import DataTable

from robbie_mp.attached.views.quantities import sparkline

TREND = "trend"
TREND_WIDTH = 12
LINE_WIDTH = 34
"""Width of columns with whole lines of text; other columns are as wide as needed."""
AS_STARTED = "start order"

Row = TypeVar("Row")
Row_contra = TypeVar("Row_contra", contravariant=True)


class Column(Protocol[Row_contra]):
    """The interface of a column."""

    @property
    def heading(self) -> str:
        """The name of the column."""

    @property
    def is_text(self) -> bool:
        """Whether the column holds text, not numbers."""

    @property
    def is_line(self) -> bool:
        """Whether the text may be long."""

    @property
    def cell(self) -> Callable[[Row_contra], Text]:
        """Makes a cell."""

    @property
    def order(self) -> Callable[[Row_contra], float | str]:
        """Sort key of the rows; numbers sort largest first."""


class FiguresTable(DataTable[Text], Generic[Row]):
    """A sortable, filterable table of figures; see the module docstring.

    Args:
        columns: the columns; the first one stays in place when you scroll the others.
        key: returns the name of a row.
        trend: returns the last values for a sparkline.
        id: id of the widget.

    Attributes:
        filter: only rows with a text that contains this are shown.
    """

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter", "select_cursor", "More", key_display="⏎")]

    def __init__(
        self,
        columns: Sequence[Column[Row]],
        key: Callable[[Row], str],
        trend: Callable[[Row], list[float]],
        *,
        id: str,
    ):
        super().__init__(id=id, cursor_type="row", zebra_stripes=False, fixed_columns=1)
        self._columns = columns
        self._key = key
        self._trend = trend
        self._sorted_by: Column[Row] | None = None
        self._reversed = False
        self.filter = ""

    @property
    def sorted_by(self) -> str:
        """Heading of the column that sorts the rows."""
        heading = self._sorted_by.heading if self._sorted_by else AS_STARTED
        return f"{heading}, reversed" if self._reversed else heading

    @property
    def selected(self) -> str | None:
        """Key of the row that the cursor is on."""
        if not self.row_count:
            return None
        return self.coordinate_to_cell_key(self.cursor_coordinate).row_key.value

    def on_mount(self) -> None:
        """Build the columns."""
        for column in self._columns:
            width = LINE_WIDTH if column.is_line else None
            self.add_column(Text(column.heading), key=column.heading, width=width)
        self.add_column(Text(TREND), key=TREND, width=TREND_WIDTH)

    def sort_by_next(self) -> None:
        """Sort by the next column; after the last one, use the given order."""
        place = self._columns.index(self._sorted_by) + 1 if self._sorted_by else 0
        self._sorted_by = self._columns[place] if place < len(self._columns) else None
        self._reversed = False

    def reverse(self) -> None:
        """Reverse the sort order."""
        self._reversed = not self._reversed

    def show(self, rows: Sequence[Row]) -> None:
        """Show these rows; the cursor stays on its row."""
        before, scroll = self.selected, self.scroll_offset
        chosen = self._chosen(rows)
        if [self._key(row) for row in chosen] == [key.value for key in self.rows]:
            self._change(chosen)
            return
        self.clear()
        for row in chosen:
            self.add_row(*self._cells(row), key=self._key(row))
        if before is not None and before in self.rows:
            self.move_cursor(row=self.get_row_index(before), animate=False, scroll=False)
        self.scroll_to(scroll.x, scroll.y, animate=False)

    def _change(self, rows: Sequence[Row]) -> None:
        """Change only cells that differ: drawing costs most here."""
        headings = [*(column.heading for column in self._columns), TREND]
        for row in rows:
            key = self._key(row)
            for heading, before, now in zip(headings, self.get_row(key), self._cells(row), strict=True):
                if (before, before.style) != (now, now.style):
                    self.update_cell(key, heading, now, update_width=True)

    def _cells(self, row: Row) -> list[Text]:
        trend = Text(sparkline(self._trend(row), TREND_WIDTH), "cyan")
        return [*(column.cell(row) for column in self._columns), trend]

    def _chosen(self, rows: Sequence[Row]) -> list[Row]:
        chosen = [row for row in rows if self._matches(row)]
        if (column := self._sorted_by) is not None:
            chosen.sort(key=column.order, reverse=not column.is_text)
        return chosen[::-1] if self._reversed else chosen

    def _matches(self, row: Row) -> bool:
        wanted = self.filter.lower()
        return not wanted or any(
            wanted in column.cell(row).plain.lower() for column in self._columns if column.is_text
        )
