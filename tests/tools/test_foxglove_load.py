"""The evaluation of what clients of Foxglove cost, and one short measurement."""

import pytest

from tools.foxglove_load.__main__ import as_table, ratios_to_without
from tools.foxglove_load.measure import STOPPED, THREE, WITHOUT, Result, measure, robot_with_server


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
    assert "three ÷ without (median of rounds; goal 1.2): small p50 1.20, small" in as_table(results, ratios)


@pytest.mark.slow
def test_three_clients_read_all_images_and_a_stopped_one_none() -> None:
    with robot_with_server() as (robot, link):
        three = measure(robot, link, THREE, seconds=1.0, settle_s=0.5)
        stopped = measure(robot, link, STOPPED, seconds=1.0, settle_s=0.5)
    assert len(three["client_mb_per_s"]) == 3 and min(three["client_mb_per_s"]) > 10
    assert stopped["client_mb_per_s"] == [0.0]
    assert stopped["small"]["count"] > 0
