"""The evaluation of what clients of Foxglove cost, and one short measurement."""

import pytest

from robbie_mp.bus.transport.histogram import middle_s
from robbie_mp.bus.transport.layout import HISTOGRAM_BUCKETS
from tools.load.foxglove.__main__ import as_table, ratios_to_without, stop_times
from tools.load.foxglove.comparison import compare
from tools.load.foxglove.measure import (
    BUSY_THREE,
    ELSEWHERE,
    STOPPED,
    THREE,
    WITHOUT,
    Result,
    measure,
    robot_with_server,
)


def session(name: str, number: int, fast: int, slow: int) -> Result:
    """A session whose messages took 0.1 ms or, a few of them, 10 times as long."""
    counts = [0] * HISTOGRAM_BUCKETS
    counts[bucket_of(100_000)], counts[bucket_of(1_000_000)] = fast, slow
    return {
        "session": name,
        "round": number,
        "small": counts,
        "image": counts,
        "server_percent": 1.0,
        "machine_percent": 2.0,
        "client_mb_per_s": [20.0] if name == THREE else [],
        "stops_ms": [number + 1.0] if name == THREE else [],
    }


def bucket_of(took_ns: int) -> int:
    return next(bucket for bucket in range(HISTOGRAM_BUCKETS) if middle_s(bucket) * 1e9 > took_ns)


def test_ratio_is_that_of_all_messages_together_and_its_interval_comes_from_the_rounds() -> None:
    slow = {WITHOUT: (0, 0, 0, 90), THREE: (20, 20, 20, 20), STOPPED: (0, 0, 0, 0)}
    results = [
        session(name, number, 1000, count)
        for name, counts in slow.items()
        for number, count in enumerate(counts)
    ]
    ratios = ratios_to_without(results)
    assert set(ratios) == {THREE, STOPPED}
    three, stopped = ratios[THREE]["small p99"], ratios[STOPPED]["small p99"]
    assert three.value == pytest.approx(
        1.0
    )  # 90 of 4090 took long without clients, too, but all in one round
    assert (three.low, three.high) == pytest.approx((1.0, 10.0), rel=0.1)
    assert stopped.value == pytest.approx(0.1, rel=0.1)
    assert ratios[THREE]["small p50"] == pytest.approx((1.0, 1.0, 1.0))
    stops = stop_times(results)
    assert (stops["count"], stops["p50_ms"], stops["max_ms"]) == (4, 2.5, 4.0)
    table = as_table(results, ratios, stops)
    assert "| three ÷ without" in table
    assert "4 emergency stops (goal p99 100 ms): median 2.5 ms, p99 4.0 ms, longest 4.0 ms" in table


def test_two_sessions_with_the_same_latencies_have_a_ratio_of_one() -> None:
    rounds = [session(WITHOUT, number, 1000, 9 * number)["small"] for number in range(4)]
    assert compare(rounds, rounds, 0.99) == pytest.approx((1.0, 1.0, 1.0))


@pytest.mark.slow
@pytest.mark.alone
def test_three_clients_read_all_images_and_stop_the_base_and_a_stopped_one_reads_none() -> None:
    with robot_with_server({}) as (robot, link):
        three = measure(robot, link, ELSEWHERE, seconds=1.0, settle_s=0.5)
        stopped = measure(robot, link, STOPPED, seconds=1.0, settle_s=0.5)
        busy = measure(robot, link, BUSY_THREE, seconds=1.0, settle_s=0.5)
    assert len(three["client_mb_per_s"]) == 3 and min(three["client_mb_per_s"]) > 10
    assert stopped["client_mb_per_s"] == [0.0]
    assert sum(stopped["small"]) > 0
    assert len(busy["stops_ms"]) > 2 and min(busy["stops_ms"]) > 0
