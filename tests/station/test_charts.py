"""Histories and sparklines."""

import math

from robbie_mp.station.panels.charts import ChartHistory, chart_options, fill, sparkline


def test_history_keeps_the_last_values_and_shows_nan_as_a_gap() -> None:
    history = ChartHistory(2)
    for time_s, value in ((1.0, 1.0), (2.0, math.nan), (3.0, 1 / 3)):
        history.add(time_s, value)
    assert history.drawn() == [[2000, None], [3000, 0.333333]]


def test_each_line_of_a_chart_gets_its_own_values() -> None:
    one, other = ChartHistory(5), ChartHistory(5)
    one.add(1.0, 10.0)
    options = chart_options(["one", "other"])
    fill(options, {"other": other, "one": one})
    assert [series["data"] for series in options["series"]] == [[[1000, 10.0]], []]


def test_sparkline_is_low_for_small_values_and_never_beyond_its_ends() -> None:
    assert sparkline([0.0, 50.0, 100.0, 170.0, -3.0], 100.0) == "▁▅██▁"
