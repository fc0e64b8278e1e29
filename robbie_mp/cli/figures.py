"""Figures of a run as a table for people and as plain data for programs."""

from collections.abc import Callable, Sequence

from rich.text import Text

from robbie_mp.cli.output import PlainTable
from robbie_mp.observe import ModuleFigures
from robbie_mp.supervisor import states
from robbie_mp.visible_text import one_line

STYLES = {"RUNNING": "green", "STARTING": "cyan", "BACKOFF": "yellow", "FAILED": "bold red", "STOPPED": "dim"}
COUNTERS = ("published", "handled", "replaced", "dropped", "lost", "refused")


def state_name(figures: ModuleFigures) -> str:
    """The state in words; '-' for who has none (the supervisor itself, or never started)."""
    return states.state_name(figures.state)


def table(modules: Sequence[ModuleFigures], *, live: bool, columns: Sequence[str] = ()) -> PlainTable:
    """One row a module.

    Args:
        modules: the figures; the supervisor's row is left out, for it neither takes nor sends on its own.
        live: whether they run: shows the status line; else the reason of the last state.
        columns: which figures, of those in `FIGURES`; all by default.
    """
    made = PlainTable()
    made.add_column("module", no_wrap=True)
    made.add_column("state", no_wrap=True)
    for heading in columns or FIGURES:
        made.add_column(heading, justify="right", no_wrap=True)
    made.add_column("status" if live else "ended")  # the one column that gives way on a narrow terminal
    for module in modules[1:]:
        state = state_name(module)
        made.add_row(
            module.name,
            Text(state, STYLES.get(state, "")),
            *(FIGURES[heading](module) for heading in columns or FIGURES),
            Text(one_line(module.status if live else module.reason), no_wrap=True, overflow="ellipsis"),
        )
    return made


def _alarming(count: int) -> Text:
    return Text(str(count), "bold red" if count else "")


FIGURES: dict[str, Callable[[ModuleFigures], Text]] = {
    "cpu s": lambda module: Text(f"{module.cpu_s:.1f}"),
    "restarts": lambda module: _alarming(module.restarts),
    "in": lambda module: Text(str(module.handled)),
    "out": lambda module: Text(str(module.published)),
    "waiting": lambda module: Text(str(module.waiting)),
    "replaced": lambda module: Text(str(module.total("replaced"))),
    "dropped": lambda module: _alarming(module.total("overflowed")),
    "left": lambda module: Text(str(module.total("left"))),
    "lost": lambda module: _alarming(module.total("lost")),
    "refused": lambda module: _alarming(module.refused),
}
LIVE_FIGURES = ("cpu s", "restarts", "in", "out", "dropped")
"""Those that leave room for the status line in 80 columns."""
