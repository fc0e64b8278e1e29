"""The evaluation of what clients of Foxglove cost, and one short measurement."""

import pytest

from tools.foxglove_load.__main__ import as_table, ratios_to_without, stop_times
from tools.foxglove_load.measure import (
    BUSY_THREE,
    STOPPED,
    THREE,
    WITHOUT,
    Result,
    measure,
    robot_with_server,
)


def session(name: str, number: int, p50_us: float) -> Result:
    latency = {"count": 9, "p50_us": p50_us, "p99_us": 10 * p50_us}
    return {
        "session": name,
        "round": number,
        "small": latency,
        "image": latency,
        "server_percent": 1.0,
        "machine_percent": 2.0,
        "client_mb_per_s": [20.0],
        "stops_ms": [number + 1.0] if name == THREE else [],
    }


def test_ratios_are_medians_over_rounds_within_each_round() -> None:
    rounds = ((100.0, 110.0, 90.0), (200.0, 600.0, 250.0), (50.0, 60.0, 50.0))
    results = [
        session(name, number, p50_us)
        for number, figures in enumerate(rounds)
        for name, p50_us in zip((WITHOUT, THREE, STOPPED), figures, strict=True)
    ]
    ratios = ratios_to_without(results)
    assert {name: round(found["small p99"], 9) for name, found in ratios.items()} == {
        THREE: 1.2,
        STOPPED: 1.0,
    }
    stops = stop_times(results)
    assert (stops["count"], stops["p50_ms"], stops["max_ms"]) == (3, 2.0, 3.0)
    table = as_table(results, ratios, stops)
    assert "three ÷ without (median of rounds; goal 1.2): small p50 1.20, small" in table
    assert "3 emergency stops (goal p99 100 ms): median 2.0 ms, p99 3.0 ms, longest 3.0 ms" in table


@pytest.mark.slow
def test_three_clients_read_all_images_and_stop_the_base_and_a_stopped_one_reads_none() -> None:
    with robot_with_server({}) as (robot, link):
        three = measure(robot, link, THREE, seconds=1.0, settle_s=0.5)
        stopped = measure(robot, link, STOPPED, seconds=1.0, settle_s=0.5)
        busy = measure(robot, link, BUSY_THREE, seconds=1.0, settle_s=0.5)
    assert len(three["client_mb_per_s"]) == 3 and min(three["client_mb_per_s"]) > 10
    assert stopped["client_mb_per_s"] == [0.0]
    assert stopped["small"]["count"] > 0
    assert len(busy["stops_ms"]) > 2 and min(busy["stops_ms"]) > 0
