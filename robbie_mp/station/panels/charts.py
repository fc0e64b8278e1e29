"""Values over time: stores the last ones, and draws them as lines."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

INK = "#ccc"
BARS = "▁▂▃▄▅▆▇█"


class ChartHistory:
    """The last values of a quantity.

    Args:
        limit: the number of values to keep.
    """

    def __init__(self, limit: int):
        self.points: deque[tuple[float, float]] = deque(maxlen=limit)
        """Time, ms since 1970, and value."""

    def add(self, time_s: float, value: float) -> None:
        """Add a value; NaN and infinity leave a gap."""
        self.points.append((round(time_s * 1e3), value))

    def drawn(self) -> list[list[float | None]]:
        """Return the points as charts take them, the oldest first."""
        return [[at, _short(value)] for at, value in tuple(self.points)]


def _short(value: float) -> float | None:
    return float(f"{value:.6g}") if math.isfinite(value) else None


def chart_options(names: Iterable[str], unit: str = "", largest: float | None = None) -> dict[str, Any]:
    """Return the options of an empty chart.

    Args:
        names: names of the lines.
        unit: unit of the values.
        largest: upper end of the scale; None: depends on the values.
    """
    return {
        "animation": False,
        "backgroundColor": "transparent",
        "grid": {"left": 60, "right": 20, "top": 48, "bottom": 30},
        "textStyle": {"color": INK},
        "legend": {"type": "scroll", "top": 0, "textStyle": {"color": INK}},
        "tooltip": {"trigger": "axis"},
        "xAxis": {"type": "time"},
        "yAxis": {
            "type": "value",
            "splitLine": {"lineStyle": {"color": "#8886"}},
            "name": unit,
            "scale": largest is None,
        }
        | ({} if largest is None else {"min": 0, "max": largest}),
        "series": [
            {"type": "line", "name": name, "showSymbol": False, "data": [], "lineStyle": {"width": 1.5}}
            for name in names
        ],
    }


def fill(options: dict[str, Any], histories: Mapping[str, ChartHistory]) -> None:
    """Put values into a chart's options."""
    for series in options["series"]:
        series["data"] = histories[series["name"]].drawn()


def sparkline(values: Iterable[float], largest: float) -> str:
    """Return values as a line of bars."""
    shares = [min(1.0, max(0.0, value / largest)) for value in values]
    return "".join(BARS[round(share * (len(BARS) - 1))] for share in shares)
