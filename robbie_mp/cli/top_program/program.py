"""The program: three views of a run, keys to sort, filter and freeze them, and to act on a module."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from rich.segment import Segment
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.color import Color
from textual.containers import VerticalScroll
from textual.filter import LineFilter
from textual.screen import ModalScreen, Screen
from textual.widgets import ContentSwitcher, DataTable, Footer, Input, Static

from robbie_mp.attached.views.process_table import (
    CHANNEL_COLUMNS,
    MODULE_COLUMNS,
    ChannelLine,
    ModuleRow,
    channel_rows,
    doing,
    graph,
    module_rows,
    totals_line,
)
from robbie_mp.attached.views.quantities import sparkline
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.visible_text import one_line, visible, without_controls
from robbie_mp.cli.top_program.details import Details
from robbie_mp.cli.top_program.feed import RunFeed, Snapshot, Watching
from robbie_mp.cli.top_program.figures_table import FiguresTable
from robbie_mp.run.control import control

if TYPE_CHECKING:
    from textual.notifications import SeverityLevel

MODULES, CHANNELS, GRAPH, MESSAGE = "modules", "channels", "graph", "message"
TREND_WIDTH = 12
UNTOUCHABLE = "supervisor"


class TopProgram(App[None]):
    """Shows a run until you quit.

    Args:
        feed: supplies the figures; the caller still owns it.
        interval_s: time between two readings.
    """

    TITLE = "robbie-top"
    ENABLE_COMMAND_PALETTE = False
    AUTO_FOCUS = None
    CSS = """
    Screen { background: $background; }
    #head { height: auto; max-height: 4; padding: 0 1; background: $panel; }
    #filter { display: none; height: 1; border: none; padding: 0 1; }
    ContentSwitcher { height: 1fr; }
    #message { padding: 1 2; }
    #graph { padding: 0 1; }
    #line { height: auto; max-height: 3; padding: 0 1; background: $panel; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("1", f"show('{MODULES}')", "Modules"),
        Binding("2", f"show('{CHANNELS}')", "Types"),
        Binding("3", f"show('{GRAPH}')", "Graph"),
        Binding("s", "sort", "Sort"),
        Binding("S", "reverse", "Reverse", show=False),
        Binding("slash", "filter", "Filter", key_display="/"),
        Binding("space", "freeze", "Hold", key_display="␣"),
        Binding("r", "act('restart')", "Restart"),
        Binding("x", "act('stop')", "Stop"),
        Binding("n", "next_run", "Next run", show=False),
        Binding("escape", "clear_filter", "Clear filter", show=False),
        Binding("q", "quit", "Quit"),
    ]

    def __init__(self, feed: RunFeed, interval_s: float):
        super().__init__()
        self._feed = feed
        self._interval_s = interval_s
        self._frozen = False
        self._shown = Snapshot(Watching.NOTHING, ())
        self._view = MODULES
        self._plain = PlainFilter()

    def compose(self) -> ComposeResult:
        """Build the widgets."""
        history = self._feed.history
        yield Static(id="head")
        yield Input(placeholder="show only what contains this", id="filter", compact=True)
        with ContentSwitcher(initial=MESSAGE):
            yield Static(id=MESSAGE)
            yield FiguresTable[ModuleRow](
                MODULE_COLUMNS,
                lambda row: row.figures.name,
                lambda row: history.values("module", row.figures.name, "in"),
                id=MODULES,
            )
            yield FiguresTable[ChannelLine](
                CHANNEL_COLUMNS,
                lambda row: row.name,
                lambda row: history.values("channel", *row.key),
                id=CHANNELS,
            )
            with VerticalScroll(id=GRAPH):
                yield Static(id="graph-text")
        yield Static(id="line")
        yield Footer(compact=True)

    def on_mount(self) -> None:
        """Start reading."""
        self.look()
        self.set_interval(self._interval_s, self.look)

    # -- display -----------------------------------------------------------------------------------------

    def look(self) -> None:
        """Read the run, and show it unless the display is frozen."""
        if not self.screen_stack or not self._main.query("#head"):
            return  # the program is ending and has removed its widgets
        snapshot = self._feed.poll()
        if not self._frozen:
            self._shown = snapshot
            self._show_all()

    @property
    def snapshot(self) -> Snapshot:
        """Return the data that is shown now."""
        return self._shown

    def selected_module(self) -> str | None:
        """Return the module under the cursor in the module view."""
        return self._modules.selected if self._view == MODULES and self._shown.reading else None

    def _show_all(self) -> None:
        shown = self._shown
        self._main.query_one("#head", Static).update(self._head())
        switcher = self._main.query_one(ContentSwitcher)
        if switcher.current != (current := self._view if shown.reading else MESSAGE):
            switcher.current = current
            self._focus_view()
        if shown.reading is None:
            self._main.query_one(f"#{MESSAGE}", Static).update(_nothing(shown))
            return
        if isinstance(self.screen, Details):
            self.screen.show(shown)
            return  # hidden views are not drawn
        rows = module_rows(shown.reading, shown.rates)
        match self._view:
            case "modules":
                self._modules.show(rows)
            case "channels":
                self._channels.show(channel_rows(shown.reading, shown.rates))
            case _:
                self._main.query_one("#graph-text", Static).update(graph(shown.reading, shown.rates))
        self._show_line(rows)

    def _head(self) -> Text:
        shown = self._shown
        head = Text.assemble(("robbie-top", "bold"))
        if shown.run is not None:
            profile = shown.run.record.profile if shown.run.record else "?"
            head.append(f"  {shown.run.run_id} {profile}")
        if shown.watching is Watching.ENDED:
            head.append("  RUN HAS ENDED", "bold red")
        if self._frozen:
            head.append("  FROZEN", "bold reverse")
        if self._view != GRAPH:
            table = self._table
            head.append(f"  sorted by {table.sorted_by}", "dim")
            if table.filter:
                head.append(f"  only '{table.filter}'", "yellow")
        if len(shown.runs) > 1:
            head.append(f"  {len(shown.runs)} runs, n: next", "dim")
        if shown.reading is not None:
            trend = sparkline(self._feed.history.values("routed"), TREND_WIDTH)
            head.append(f"  {trend}", "cyan")
            head.append("\n").append(totals_line(shown.reading, shown.rates))
        return head

    def _show_line(self, rows: list[ModuleRow]) -> None:
        """Show which modules hang, and the status of the selected module."""
        name = self.selected_module()
        parts = [
            Text.assemble((one_line(row.figures.name), "bold"), ": ", doing(row))
            for row in rows
            if row.is_hung or row.figures.name == name
        ]
        line = self._main.query_one("#line", Static)
        line.update(Text("\n").join(parts))
        line.display = bool(parts)

    @property
    def _main(self) -> Screen[object]:
        """The screen with the views, even if another screen covers it."""
        return self.screen_stack[0]

    @property
    def _modules(self) -> "FiguresTable[ModuleRow]":
        table: FiguresTable[ModuleRow] = self._main.query_one(f"#{MODULES}", FiguresTable)
        return table

    @property
    def _channels(self) -> "FiguresTable[ChannelLine]":
        table: FiguresTable[ChannelLine] = self._main.query_one(f"#{CHANNELS}", FiguresTable)
        return table

    @property
    def _table(self) -> "FiguresTable[ModuleRow] | FiguresTable[ChannelLine]":
        return self._channels if self._view == CHANNELS else self._modules

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Allow changing, sorting and filtering views only while they are visible."""
        of_views = ("show", "sort", "reverse", "filter", "clear_filter", "next_run")
        if action in of_views and len(self.screen_stack) > 1:
            return False
        return super().check_action(action, parameters)

    # -- keys --------------------------------------------------------------------------------------------

    def action_show(self, view: str) -> None:
        """Change the view."""
        self._view = view
        self._show_all()

    def _focus_view(self) -> None:
        self._main.query_one(f"#{self._view}").focus()

    def action_sort(self) -> None:
        """Sort by the next column."""
        self._table.sort_by_next()
        self._show_all()

    def action_reverse(self) -> None:
        """Reverse the sort order."""
        self._table.reverse()
        self._show_all()

    def action_filter(self) -> None:
        """Ask for the filter text."""
        field = self._main.query_one("#filter", Input)
        field.value = self._table.filter
        field.display = True
        field.focus()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Filter while the user types."""
        self._table.filter = event.value
        self._show_all()

    def on_input_submitted(self) -> None:
        """Keep the filter, and go back to the table."""
        self._main.query_one("#filter", Input).display = False
        self._focus_view()

    def action_clear_filter(self) -> None:
        """Show everything again."""
        self._table.filter = ""
        self.on_input_submitted()
        self._show_all()

    def action_freeze(self) -> None:
        """Freeze or resume the display."""
        self._frozen = not self._frozen
        if self._frozen:
            self._show_all()
        else:
            self.look()

    def action_next_run(self) -> None:
        """Watch another run."""
        self._feed.choose_next()
        self._frozen = False
        self.look()

    def on_data_table_row_highlighted(self, _event: DataTable.RowHighlighted) -> None:
        """Show the status of the module under the cursor."""
        if self._shown.reading is not None:
            self._show_line(module_rows(self._shown.reading, self._shown.rates))

    def on_data_table_row_selected(self, _event: DataTable.RowSelected) -> None:
        """Show the details of the module on which you pressed Enter."""
        self.action_details()

    def action_details(self) -> None:
        """Show all figures of one module."""
        name = self.selected_module()
        if name is not None:
            self.push_screen(Details(name, self._feed.history), lambda _: None)
            self.call_after_refresh(self._show_all)

    def action_act(self, command: str) -> None:
        """Restart or stop the module, if the user confirms."""
        name = self.screen.module if isinstance(self.screen, Details) else self.selected_module()
        run = self._shown.run
        if name is None or run is None or isinstance(self.screen, Confirmation):
            return
        if name == UNTOUCHABLE or (name == "core" and command == "stop"):
            self._tell(f"{name} cannot be told to {command}; `robbie stop` ends the run", "warning")
            return

        def act(is_sure: bool | None) -> None:
            if is_sure:
                self.run_worker(lambda: self._control(command, name), thread=True, group="control")

        self.push_screen(Confirmation(f"{command} {name} of run {run.run_id}?"), act)

    def _control(self, command: str, name: str) -> None:
        """Send the command to the supervisor, in a thread because it takes a while."""
        run = self._shown.run
        assert run is not None
        try:
            said, severity = control(run.folder, command, name), "information"
        except RobbieError as error:
            said, severity = str(error), "error"
        self.call_from_thread(self._tell, said, severity)

    def _tell(self, text: str, severity: "SeverityLevel") -> None:
        self.notify(visible(text), severity=severity, markup=False)

    def get_line_filters(self) -> Sequence[LineFilter]:
        """Add the filter for everything that is drawn."""
        return [*super().get_line_filters(), self._plain]


def _nothing(shown: Snapshot) -> Text:
    if shown.watching is Watching.SEVERAL:
        profiles = [run.record.profile if run.record else "?" for run in shown.runs]
        lines = [
            one_line(f"  {run.run_id}  {profile}") for run, profile in zip(shown.runs, profiles, strict=True)
        ]
        return Text("\n".join(["There are several runs; n shows the next one:", "", *lines]))
    return Text("There is no such run. `robbie run PROFILE` starts one, which is then shown here.")


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
