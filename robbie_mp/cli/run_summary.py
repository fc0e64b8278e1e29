"""What `robbie run` prints at the end: what was achieved, what became of all messages, and the results."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.text import Text

from robbie_mp.attached.views.quantities import size
from robbie_mp.attached.views.run_figures import said, state_name, table
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe import ModuleFigures
from robbie_mp.cli.output import console
from robbie_mp.run.supervisor.run import SUMMARY_FILE, RunResult
from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.trace.reader import LOG_FOLDER

MAX_FILES = 12
IN_ORDER = "exit code 0"


def print_summary(result: RunResult, duration_s: object) -> None:
    """Print the end of a run for a user to read."""
    out = console()
    out.print(table(result.figures, live=False))
    lines = [
        *last_words(result.figures),
        *account(result.figures),
        *(f"{name} was DEGRADED when the run stopped: {why}" for name, why in result.degraded.items()),
        f"run ended after {duration_s} s: {result.reason}; exit code {result.exit_code}",
        f"results: {result.output_directory}{files(result.output_directory)}",
    ]
    for line in lines:
        out.print(Text(one_line(line)), soft_wrap=True)


def last_words(figures: Sequence[ModuleFigures]) -> Iterator[str]:
    """Return a line for each process that did not end in order, or that shows what it has done."""
    for module in figures[1:]:
        is_in_order = state_name(module) == ChildState.STOPPED and IN_ORDER in module.reason
        parts = ("" if is_in_order else module.reason, said(module))
        if any(parts):
            yield f"{module.name}: {'  '.join(filter(None, parts))}"


def account(figures: Sequence[ModuleFigures]) -> Iterator[str]:
    """Return what became of all messages: one line, and one for each that was not handled as it should."""
    modules = figures[1:-1]
    books = [entry for module in modules for entry in module.subscriptions]
    missing = [line for module in modules for line in _missing(module)]
    yield (
        f"messages: {sum(one.delivered for one in books)} of {sum(one.routed for one in books)} handled, "
        f"{sum(one.replaced for one in books)} replaced by newer ones, "
        f"{sum(one.left for one in books)} left when their module stopped; "
        + ("these were not handled:" if missing else "every message is accounted for")
    )
    yield from missing


def _missing(module: ModuleFigures) -> Iterator[str]:
    for count, what in (
        (module.total("overflowed"), "dropped because it was too slow"),
        (module.total("lost"), "lost in its crashes"),
        (module.total("waiting"), "in its queue when the core ended"),
        (module.ill_formed, "refused: ill-formed, or of another version; the log says which"),
    ):
        if count:
            yield f"    {module.name}: {count} {what}"
    if module.refused:
        yield f"    {module.name}: {module.refused} of its own refused because its memory or a table was full"


def files(folder: Path) -> str:
    """Return the results in a folder with their sizes, beside log and summary; '' if there are none."""
    try:
        found = sorted(path for path in folder.iterdir() if path.name not in (LOG_FOLDER, SUMMARY_FILE))
    except OSError as error:  # somebody has removed it
        return f" cannot be read any more ({error.strerror})"
    names = [f"{one.name}/" if one.is_dir() else f"{one.name} ({size(one.stat().st_size)})" for one in found]
    if len(names) > MAX_FILES:
        names[MAX_FILES:] = [f"{len(names) - MAX_FILES} more"]
    return f": {', '.join(names)}" if names else ""
