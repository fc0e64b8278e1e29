"""Robbie's performance goals, most of them ratios within one run, and whether it meets them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tools.bench.options import IN_PLACE
from tools.bench.table import middle, ratio, render

Row = dict[str, Any]
Figure = Callable[["Results"], tuple[float | None, str]]
"""Returns the measured figure (None if it was not measured), and the title of what it is compared to."""


@dataclass(frozen=True)
class PerformanceGoal:
    """One performance goal.

    Attributes:
        title: what is measured.
        limit: maximum of the figure, or its minimum with `at_least`.
        figure: finds it.
        at_least: whether `limit` is a minimum.
    """

    title: str
    limit: float
    figure: Figure
    at_least: bool = False


class Results:
    """Finds rows in the results of a run."""

    def __init__(self, results: Sequence[Row]):
        self._results = results

    def rows(self, benchmark: str, part: str = "") -> list[Row]:
        """Return the contenders of the first result of a benchmark whose title begins with `part`."""
        for result in self._results:
            if result["benchmark"] == benchmark and result["title"].startswith(part):
                rows: list[Row] = result["contenders"]
                return rows
        return []

    def row(self, benchmark: str, name: str, part: str = "") -> Row:
        """Return the row of one contender, or {} if there is none."""
        return next((row for row in self.rows(benchmark, part) if row["name"] == name), {})

    def best(self, benchmark: str, column: str, part: str = "", *, in_place: bool = False) -> Row:
        """Return the row of the peer with the lowest median in a column, or {} if there is none.

        Args:
            benchmark: name of the benchmark.
            column: name of the column.
            part: beginning of the result's title.
            in_place: search the peers that fill arrays in place, instead of those that copy them.
        """
        rows = [row for row in self.rows(benchmark, part) if row["name"].endswith(IN_PLACE) == in_place]
        peers = [row for row in rows if is_peer(row) and middle(row.get(column, ()))]
        return min(peers, key=lambda row: middle(row[column]) or 0.0, default={})


def is_peer(row: Row) -> bool:
    """Return whether a row belongs to a peer, rather than to Robbie or a floor."""
    return not row["name"].startswith(("robbie", "floor", "memcpy"))


def _against(benchmark: str, name: str, other: str, part: str = "", column: str = "p50_us") -> Figure:
    """Return a function that divides a contender's figure by that of another one."""

    def figure(results: Results) -> tuple[float | None, str]:
        row, compared = results.row(benchmark, name, part), results.row(benchmark, other, part)
        return ratio(row, compared, column), compared.get("title", other)

    return figure


def _against_best(
    benchmark: str, name: str, part: str = "", column: str = "p50_us", *, in_place: bool = False
) -> Figure:
    """Return a function that divides a contender's figure by the best peer's."""

    def figure(results: Results) -> tuple[float | None, str]:
        best = results.best(benchmark, column, part, in_place=in_place)
        return ratio(results.row(benchmark, name, part), best, column), best.get("title", "no peer")

    return figure


def _copy_and_wake(results: Results) -> tuple[float | None, str]:
    image = middle(results.row("large", "robbie", "6.2").get("p50_us", ()))
    copy = middle(results.row("large", "memcpy", "6.2").get("p50_us", ()))
    small = middle(results.row("large", "robbie 64 B", "6.2").get("p50_us", ()))
    return (image / (copy + small) if image and copy and small else None), "memcpy + 64 B"


def _of_row(benchmark: str, name: str, column: str) -> Figure:
    def figure(results: Results) -> tuple[float | None, str]:
        values = results.row(benchmark, name).get(column, ())
        return middle([float(value) for value in values]), ""

    return figure


IN = "robbie in place"
OFTEN, SELDOM, FIFO = "64 bytes, 1 kHz, ", "64 bytes, 30 Hz, ", "64 bytes, 1 kHz at SCHED_FIFO"
"""Beginnings of the titles of the results of `latency`."""
TIME = "us_per_message"
GOALS = (
    PerformanceGoal("64 B, 1 kHz: p50 ÷ floor", 1.3, _against("latency", "robbie", "floor", OFTEN)),
    PerformanceGoal("64 B, 1 kHz: p50 ÷ best peer", 0.75, _against_best("latency", "robbie", OFTEN)),
    PerformanceGoal("64 B, 1 kHz: p99 ÷ best peer", 1.0, _against_best("latency", "robbie", OFTEN, "p99_us")),
    PerformanceGoal("64 B, 30 Hz: p50 ÷ floor", 1.3, _against("latency", "robbie", "floor", SELDOM)),
    PerformanceGoal("64 B, 30 Hz: p50 ÷ best peer", 0.75, _against_best("latency", "robbie", SELDOM)),
    PerformanceGoal(
        "64 B, all at SCHED_FIFO: p99 ÷ best peer", 1.0, _against_best("latency", "robbie", FIFO, "p99_us")
    ),
    PerformanceGoal("1 MB in place: p50 ÷ own 64 B", 1.5, _against("large", IN, "robbie 64 B", "1 MB")),
    PerformanceGoal("6.2 MB in place: p50 ÷ own 64 B", 1.5, _against("large", IN, "robbie 64 B", "6.2")),
    PerformanceGoal("6.2 MB in place: p50 ÷ best peer that copies", 0.1, _against_best("large", IN, "6.2")),
    PerformanceGoal(
        "1 MB in place: p50 ÷ best peer in place", 1.0, _against_best("large", IN, "1 MB", in_place=True)
    ),
    PerformanceGoal(
        "6.2 MB in place: p50 ÷ best peer in place", 1.0, _against_best("large", IN, "6.2", in_place=True)
    ),
    PerformanceGoal("6.2 MB copied: p50 ÷ best peer", 1.0, _against_best("large", "robbie", "6.2")),
    PerformanceGoal("6.2 MB copied: p50 ÷ (memcpy + 64 B)", 1.1, _copy_and_wake),
    PerformanceGoal("1 MB to 8 in place: p50 ÷ best peer that copies", 0.3, _against_best("fanout", IN)),
    PerformanceGoal(
        "1 MB to 8 in place: p50 ÷ best peer in place", 0.8, _against_best("fanout", IN, in_place=True)
    ),
    PerformanceGoal("1 MB to 8 copied: p50 ÷ best peer", 0.3, _against_best("fanout", "robbie")),
    PerformanceGoal("flat out: messages/s", 200_000, _of_row("throughput", "robbie", "received_per_s"), True),
    PerformanceGoal(
        "flat out: messages/s ÷ iceoryx2",
        1.0,
        _against("throughput", "robbie", "iceoryx2", column="received_per_s"),
        True,
    ),
    PerformanceGoal("flat out: lost", 0, _of_row("throughput", "robbie", "lost")),
    PerformanceGoal("20 idle modules: % of a core", 1.0, _of_row("idle", "robbie", "cpu_percent")),
    PerformanceGoal(
        "20 modules, 1,500 messages/s: robot ÷ floor",
        1.3,
        _against("loaded", "robbie", "floor", column=TIME),
    ),
    PerformanceGoal(
        "20 modules, 1,500 messages/s: robot ÷ best peer",
        1.0,
        _against_best("loaded", "robbie", column=TIME),
    ),
    PerformanceGoal(
        "call and reply, 64 B each: p50 ÷ one way", 2.2, _against("call", "robbie-call", "robbie")
    ),
    PerformanceGoal(
        "SIGKILL to next message: median ms", 60.0, _of_row("restart", "robbie small", "away_ms")
    ),
)


def goal_table(results: Sequence[Row]) -> str:
    """Return a table of the goals whose figures were measured; '' if there are none."""
    found = Results(results)
    lines = []
    for goal in GOALS:
        figure, compared = goal.figure(found)
        limit = f"{'≥' if goal.at_least else '≤'} {goal.limit:,g}"
        if figure is None:
            continue
        reached = figure >= goal.limit if goal.at_least else figure <= goal.limit
        lines.append([goal.title, limit, f"{figure:,.2f}", compared, "yes" if reached else "no"])
    return render(["", "goal", "measured", "compared to", "met"], lines) if lines else ""
