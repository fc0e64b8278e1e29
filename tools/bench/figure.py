"""Draws the results of a run. Needs matplotlib, which the extra `bench` installs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tools.bench.table import middle

Row = dict[str, Any]

ROBBIE, FLOOR, PEER = "#c0392b", "#7f8c8d", "#2c6fbb"


def draw(results: Sequence[Row], file: Path) -> None:
    """Draw one panel for each result with latencies or rates."""
    from matplotlib.figure import Figure  # noqa: PLC0415 (optional)

    shown = [result for result in results if result["kind"] in ("latency", "throughput")]
    columns = 2
    lines = -(-len(shown) // columns)
    figure = Figure(figsize=(13, 3.6 * lines), layout="constrained")
    for place, result in enumerate(shown):
        axes = figure.add_subplot(lines, columns, place + 1)
        if result["kind"] == "latency":
            _draw_latencies(axes, result)
        else:
            _draw_rates(axes, result)
        axes.set_title(f"{result['benchmark']}: {result['title']}", fontsize=10)
        axes.tick_params(labelsize=8)
        axes.grid(axis="x", alpha=0.3)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=90)


def _draw_latencies(axes: Any, result: Row) -> None:
    """Draw a bar up to the p50, on a logarithmic scale, and a mark at the p99."""
    rows = _measured(result, "p50_us")
    p50_us = [middle(row["p50_us"]) for row in rows]
    axes.barh(_titles(rows), p50_us, color=[_colour(row) for row in rows])
    axes.plot([middle(row["p99_us"]) for row in rows], range(len(rows)), "k|", markersize=10, label="p99")
    for place, value in enumerate(p50_us):
        axes.text(value, place, f" {value:,.0f}", fontsize=7, va="center")
    axes.set_xscale("log")
    axes.set_xlabel("µs; bar: p50, mark: p99", fontsize=8)


def _draw_rates(axes: Any, result: Row) -> None:
    rows = _measured(result, "received_per_s")
    titles = [
        title + (f" (lost {sum(row['lost']) / sum(row['wanted']):.0%})" if sum(row["lost"]) else "")
        for title, row in zip(_titles(rows), rows, strict=True)
    ]
    axes.barh(titles, [middle(row["received_per_s"]) for row in rows], color=[_colour(row) for row in rows])
    axes.set_xlabel("messages received/s", fontsize=8)


def _measured(result: Row, column: str) -> list[Row]:
    """Return the rows with figures, sorted so that the best is at the top."""
    rows = [row for row in result["contenders"] if middle(row.get(column, ())) is not None]
    return sorted(rows, key=lambda row: middle(row[column]) or 0.0, reverse=result["kind"] == "latency")


def _titles(rows: Sequence[Row]) -> list[str]:
    return [row["title"] for row in rows]


def _colour(row: Row) -> str:
    if row["name"].startswith("robbie"):
        return ROBBIE
    return FLOOR if row["title"].startswith("floor") else PEER
