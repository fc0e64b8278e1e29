"""Renders results as tables, both for the terminal and for Markdown."""

from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

import numpy as np

Row = dict[str, Any]
Figures = Sequence[float | None]


def middle(values: Figures) -> float | None:
    """Return the median over all rounds, or None if there is none."""
    present = [value for value in values if value is not None]
    return median(present) if present else None


def ratio(row: Row, other: Row, column: str) -> float | None:
    """Return the median of the ratios within each round."""
    values, others = _by_round(row, column), _by_round(other, column)
    pairs = ((value, others.get(number)) for number, value in values.items())
    return middle([one / another for one, another in pairs if one is not None and another])


def _by_round(row: Row, column: str) -> dict[int, float | None]:
    return dict(zip(row["rounds"], row[column], strict=True)) if row.get(column) else {}


def render(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Render a Markdown table with aligned columns: the first one left, the others right."""
    complete = [[*row, *[""] * (len(header) - len(row))] for row in rows]
    widths = [max(len(row[place]) for row in (header, *complete)) for place in range(len(header))]
    rule = [("-" * width if place == 0 else "-" * (width - 1) + ":") for place, width in enumerate(widths)]

    def line(cells: Sequence[str]) -> str:
        aligned = [
            cell.ljust(width) if place == 0 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        return f"| {' | '.join(aligned)} |"

    return "\n".join([line(header), line(rule), *map(line, complete)])


def number(value: float | None, digits: int = 1) -> str:
    """Format a figure, or return '' if there is none."""
    return "" if value is None else f"{value:,.{digits}f}"


def short_number(value: float | None) -> str:
    """Format a figure with three significant digits, or without decimals from 100 on; '' if there is none."""
    return "" if value is None else f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def reference(result: Row) -> Row:
    """Return the row that the others are compared to, or {} if it was not measured."""
    name = result.get("reference", "")
    return next((row for row in result["contenders"] if row["name"] == name), {})


def _title(row: Row) -> str:
    name = f"{row['title']} {row['version']}".strip()
    if row["trouble"]:
        said = " ".join(row["trouble"].split())
        return f"{name}: {said[:80]}"
    return name


def _latency(result: Row) -> str:
    compared = reference(result)
    name = compared.get("title", "Robbie-MP")
    lines = []
    for row in result["contenders"]:
        p50_us = [value for value in row.get("p50_us", ()) if value is not None]
        cells = [_title(row)]
        if p50_us:
            cells += [
                number(middle(p50_us)),
                number(middle(row["p99_us"])),
                f"{number(min(p50_us))} to {number(max(p50_us))}",
                number(ratio(row, compared, "p50_us"), 2),
                number(ratio(row, compared, "p99_us"), 2),
            ]
        elif row.get("sent"):
            cells += ["", "", "", "", ""]
        cells += [f"{sum(row['lost']):,}/{sum(row['wanted']):,}"] if row.get("sent") else []
        lines.append(cells)
    header = ["", "p50 µs", "p99 µs", "p50 per round", f"p50 ÷ {name}", f"p99 ÷ {name}", "lost"]
    return render(header, lines)


def _throughput(result: Row) -> str:
    lines = []
    for row in result["contenders"]:
        cells = [_title(row)]
        if row.get("sent"):
            received = row["received_per_s"]
            cells += [
                number(middle(received), 0),
                f"{number(min(received), 0)} to {number(max(received), 0)}",
                f"{sum(row['sent']):,}",
                f"{sum(row['lost']):,}",
            ]
        lines.append(cells)
    return render(["", "received/s", "per round", "sent", "lost"], lines)


def _idle(result: Row) -> str:
    columns = {"cpu_percent": 2, "memory_mib": 0, "start_s": 2}
    lines = [
        [_title(row), *(number(middle(row.get(name, ())), digits) for name, digits in columns.items())]
        for row in result["contenders"]
    ]
    return render(["", "% of one core", "memory MiB", "start s"], lines)


def _loaded(result: Row) -> str:
    lines = [
        [_title(row), number(middle(row["us_per_message"]), 0), number(middle(row["cpu_percent"]))]
        for row in result["contenders"]
    ]
    return render(["", "µs for each message", "% of one core"], lines)


def _pipeline(result: Row) -> str:
    lines = []
    for row in result["contenders"]:
        cells = [_title(row)]
        if row.get("sent"):
            cells += [number(middle(row[column])) for column in ("p50_us", "p99_us", "cpu_percent")]
            cells += [f"{sum(row['lost']):,}/{sum(row['wanted']):,}"]
        lines.append(cells)
    return render(["", "age p50 µs", "age p99 µs", "% of one core", "lost"], lines)


def _restart(result: Row) -> str:
    lines = []
    for row in result["contenders"]:
        away_ms = row.get("away_ms")
        figures = (middle(away_ms), float(np.quantile(away_ms, 0.99))) if away_ms else ()
        lines.append([_title(row), *map(number, figures)])
    return render(["", "median ms", "p99 ms"], lines)


TABLES: dict[str, Callable[[Row], str]] = {
    "latency": _latency,
    "throughput": _throughput,
    "idle": _idle,
    "loaded": _loaded,
    "pipeline": _pipeline,
    "restart": _restart,
}


def table(result: Row) -> str:
    """Return the table of one result."""
    return TABLES[result["kind"]](result)
