"""The evaluation of the measurement of the logger's load, and one session."""

from tools.load.__main__ import as_table, ratios_to_without
from tools.load.measure import PAIRS, TAKER, WITHOUT, Result, measure, profile


def session(recorder: str, round_number: int, p50_us: float) -> Result:
    latency = {"count": 9, "p50_us": p50_us, "p99_us": 10 * p50_us}
    return {
        "recorder": recorder,
        "round": round_number,
        "small": latency,
        "image": latency,
        "core_percent": 1.0,
        "machine_percent": 2.0,
    }


def test_ratios_are_medians_over_rounds_within_each_round() -> None:
    results = [
        session(recorder, number, p50_us)
        for number, (without, logger) in enumerate(((100.0, 110.0), (200.0, 600.0), (50.0, 60.0)))
        for recorder, p50_us in ((WITHOUT, without), ("logger", logger))
    ]
    ratios = ratios_to_without(results)
    assert ratios == {"logger": dict.fromkeys(("small p50", "small p99", "image p50", "image p99"), 1.2)}
    assert "goal 1.2): small p50 1.20, small p99" in as_table(results, ratios)


def test_ratio_above_the_goal_is_marked() -> None:
    results = [session(WITHOUT, 0, 100.0), session("logger", 0, 121.0)]
    assert "small p50 1.21 !" in as_table(results, ratios_to_without(results))


def test_twenty_modules_are_measured_and_the_recorder_stops_last() -> None:
    assert len(profile(WITHOUT)["modules"]) == 2 * PAIRS + 2 == 20
    assert next(iter(profile(TAKER)["modules"])) == "recorder"


def test_session_has_the_stated_traffic_and_its_counters_balance() -> None:
    result = measure(TAKER, seconds=2.0, settle_s=0.0)
    assert result["small"]["count"] > 10
    assert result["image"]["count"] >= 1
    assert (result["dropped"], result["lost"]) == (0, 0)
    assert result["handled"] >= result["small"]["count"] + result["image"]["count"]
    assert result["recorder_percent"] > 0
    assert "log_dropped" not in result
