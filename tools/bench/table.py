"""Turns results into text: one table for the terminal and for Markdown."""

from collections.abc import Sequence
from statistics import median
from typing import Any

Row = dict[str, Any]


def middle(values: Sequence[float]) -> float | None:
    """Median over rounds; None if there was none."""
    return median(values) if values else None


def ratio(row: Row, other: Row, column: str) -> float | None:
    """Median of the ratios within each round."""
    pairs = zip(row.get(column, ()), other.get(column, ()), strict=False)
    return middle([one / another for one, another in pairs if another])


def render(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Align columns as a Markdown table; all but the first to the right."""
    widths = [max(len(row[place]) for row in (header, *rows)) for place in range(len(header))]
    rule = [("-" * width if place == 0 else "-" * (width - 1) + ":") for place, width in enumerate(widths)]

    def line(cells: Sequence[str]) -> str:
        aligned = [
            cell.ljust(width) if place == 0 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ]
        return f"| {' | '.join(aligned)} |"

    return "\n".join([line(header), line(rule), *map(line, rows)])


def number(value: float | None, digits: int = 1) -> str:
    """Format a figure; '' if there is none."""
    return "" if value is None else f"{value:,.{digits}f}"


def latency_table(result: Row) -> str:
    """Return the table of one work: latencies, their ratios to the reference, losses."""
    rows = result["contenders"]
    reference = next((row for row in rows if row["name"] == result["reference"]), {})
    lines = []
    for row in rows:
        title = f"{row['title']} {row['version']}".strip()
        if not row["rounds"]:
            lines.append([f"{title}: {first_line(row['trouble'])}", "", "", "", "", "", ""])
            continue
        lines.append(
            [
                title + (" (failed in a later round)" if row["trouble"] else ""),
                number(middle(row["p50_us"])),
                number(middle(row["p99_us"])),
                f"{number(min(row['p50_us'], default=None))} to {number(max(row['p50_us'], default=None))}",
                number(ratio(row, reference, "p50_us"), 2),
                number(ratio(row, reference, "p99_us"), 2),
                f"{row['lost']}/{row['sent']}",
            ]
        )
    name = reference.get("title", result["reference"])
    header = ["", "p50 µs", "p99 µs", "p50 of rounds", f"p50 ÷ {name}", f"p99 ÷ {name}", "lost"]
    return render(header, lines)


def first_line(text: str) -> str:
    """Return what a trouble says, without what came after."""
    return text.strip().splitlines()[0][:70] if text.strip() else ""
