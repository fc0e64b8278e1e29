"""Writes the results of a run into the documentation, between two marker lines."""

from pathlib import Path
from typing import Any

from tools.bench.figure import draw
from tools.bench.goals import goal_table
from tools.bench.standard_table import standard_table
from tools.bench.table import render, table

BEGIN = "<!-- begin: written by `python -m tools.bench --report` -->"
END = "<!-- end -->"
PAGE = "benchmarks.md"
PICTURE = "images/benchmarks.png"


class NoPlaceForResults(ValueError):
    """The page lacks the two marker lines for the results."""


def write_report(run: dict[str, Any], folder: Path) -> None:
    """Write the results of a run into `benchmarks.md` in a folder, and draw its picture.

    Args:
        run: the results, in the form that `--json` writes.
        folder: folder of the documentation.

    Raises:
        NoPlaceForResults: the page lacks the marker lines.
    """
    page = folder / PAGE
    text = page.read_text()
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise NoPlaceForResults(f"{page} needs a line {BEGIN!r} and after it a line {END!r}")
    draw(run["results"], folder / PICTURE)
    page.write_text(f"{before}{BEGIN}\n{results_text(run)}\n{END}{after}")


def results_text(run: dict[str, Any]) -> str:
    """Return the results of a run as Markdown."""
    parts = [described(run), f"![Latencies and rates]({PICTURE})", "### Goals", goal_table(run["results"])]
    if run.get("standard"):
        parts += ["### All figures", standard_table(run["results"])]
    else:
        for result in run["results"]:
            parts += [f"### {result['benchmark']}: {result['title']}", table(result)]
    parts += ["### Contenders", _setups(run["results"])]
    return "\n" + "\n\n".join(parts) + "\n"


def described(run: dict[str, Any]) -> str:
    """Return what was measured on which machine, in one line."""
    machine = run["machine"]
    return (
        f"Measured {machine['date']} on {machine['processor']}, {machine['cores']} cores, "
        f"{machine['memory_gib']} GiB, {machine['kernel']}, Python {machine['python']}; load before: "
        f"{machine['load_before']}. Command: `{run['command']}`."
    )


def _setups(results: list[dict[str, Any]]) -> str:
    found: dict[str, list[str]] = {}
    for result in results:
        for row in result["contenders"]:
            if row.get("how") and "bus" not in row and result["kind"] != "scale":
                title = row["title"].split(",")[0]
                state = row["trouble"] if not row["rounds"] and row["trouble"] else ""
                found.setdefault(title, [title, row["version"], row["how"], state])
    return render(["", "version", "how", "why absent"], list(found.values()))
