"""The table of the standard comparison: a line for each figure, a column for each contender."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tools.bench.goals import is_peer
from tools.bench.machine import NOT_COMPARABLE
from tools.bench.table import middle, ratio, render, short_number

Row = dict[str, Any]

FLOORS = ("floor", "memcpy")
"""They share a column: no result has both."""
ABSENT = "-"


@dataclass(frozen=True)
class TableLine:
    """One line of the table for each result of a kind.

    Attributes:
        kind: of the result.
        column: of the result's rows.
        title: with the unit.
        most_is_best: whether more is better.
        messages: how many a round must have, so that the figure means something.
    """

    kind: str
    column: str
    title: str
    most_is_best: bool = False
    messages: int = 0


FIGURES = (
    TableLine("latency", "p50_us", "p50 µs"),
    TableLine("latency", "p99_us", "p99 µs", messages=500),
    TableLine("latency", "p999_us", "p99.9 µs", messages=10_000),
    TableLine("throughput", "received_per_s", "messages/s", most_is_best=True),
    TableLine("throughput", "lost", "messages lost"),
    TableLine("loaded", "us_per_message", "processor µs for a message"),
    TableLine("idle", "cpu_percent", "% of one processor"),
    TableLine("idle", "memory_mib", "memory MiB"),
    TableLine("idle", "start_s", "until all run, s"),
)


def standard_table(results: Sequence[Row]) -> str:
    """Return one table of all figures, and below it why figures are missing."""
    titles = _contenders(results)
    lines = [
        [f"{result['title']}: {figure.title}", *_cells(_by_contender(result), figure, titles)]
        for result, figure in _figures(results)
    ]
    for result in results:
        if result["kind"] == "restart":
            lines += [_restart_line(row, titles) for row in result["contenders"]]
    table = render(["", *titles.values(), "Robbie-MP ÷ floor", "÷ best peer"], lines)
    return "\n".join([table, "", *(f"- {text}" for text in _troubles(results))]).rstrip()


def _contenders(results: Sequence[Row]) -> dict[str, str]:
    """Return the titles of those that were measured, with their versions, by name."""
    titles: dict[str, str] = {}
    for result in results:
        for name, row in _by_contender(result).items():
            if row["trouble"] and not row["rounds"] and not row["trouble"].startswith(NOT_COMPARABLE):
                continue
            titles.setdefault(name, name if name in FLOORS else f"{row['title']} {row['version']}".strip())
    return titles


def _by_contender(result: Row) -> dict[str, Row]:
    """Return the rows by name, without what only some results have."""
    if result["kind"] == "restart":
        return {}
    names = ((FLOORS[0] if row["name"] in FLOORS else row["name"], row) for row in result["contenders"])
    return {name: row for name, row in names if " " not in name}


def _figures(results: Sequence[Row]) -> Iterator[tuple[Row, TableLine]]:
    for result in results:
        sent = max((max(row["sent"]) for row in result["contenders"] if row.get("sent")), default=0)
        for figure in FIGURES:
            if figure.kind == result["kind"] and sent >= figure.messages:
                yield result, figure


def _cells(rows: Mapping[str, Row], figure: TableLine, titles: Mapping[str, str]) -> list[str]:
    values = {name: middle(row.get(figure.column, ())) for name, row in rows.items()}
    others = {name: value for name, value in values.items() if value is not None and is_peer({"name": name})}
    best = (max if figure.most_is_best else min)(others, key=lambda name: others[name], default="")
    cells = [_cell(rows[name], values[name]) if name in rows else "" for name in titles]
    return [*cells, *(_ratio(rows, other, figure.column) for other in (FLOORS[0], best))]


def _cell(row: Row, value: float | None) -> str:
    if value is not None:
        return short_number(value)
    return NOT_COMPARABLE if row["trouble"].startswith(NOT_COMPARABLE) else ABSENT


def _ratio(rows: Mapping[str, Row], other: str, column: str) -> str:
    """Return the median of Robbie's ratios to another contender within each round."""
    found = ratio(rows["robbie"], rows[other], column) if "robbie" in rows and other in rows else None
    return "" if found is None else f"{found:.2f}"


def _restart_line(row: Row, titles: Mapping[str, str]) -> list[str]:
    cell = _cell(row, middle(row.get("away_ms", ())))
    title = f"SIGKILL to next message, {row['title']}: median ms"
    return [title, *(cell if name == "robbie" else "" for name in titles)]


def _troubles(results: Sequence[Row]) -> list[str]:
    """Return each reason for which a figure is missing once, and where it is."""
    where: dict[str, list[str]] = {}
    for result in results:
        for row in result["contenders"]:
            if row["trouble"]:
                why = f"{row['title']}: {' '.join(row['trouble'].split())[:160]}"
                where.setdefault(why, []).append(result["title"])
    everywhere = len([result for result in results if result["kind"] != "restart"])
    return [
        why if len(titles) >= everywhere else f"{why} ({'; '.join(titles)})" for why, titles in where.items()
    ]
