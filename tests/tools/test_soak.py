"""How the soak test evaluates its samples."""

import pytest

from tools.kill_campaign.soak import MEGABYTE, SAMPLE_S, Sample, Watch


def samples(growth_mb_per_h: float, pids: list[int]) -> list[Sample]:
    per_s = growth_mb_per_h * MEGABYTE / 3600
    found = []
    for number, pid in enumerate(pids):
        held = 50 * MEGABYTE + round(per_s * number * SAMPLE_S)
        found.append(Sample(number * SAMPLE_S, pid, 2 * held, held, 9, 40))
    return found


@pytest.mark.parametrize("growth_mb_per_h", [0.0, 3.6, -7.2])
def test_growth_is_found(growth_mb_per_h: float) -> None:
    report = Watch({"core": samples(growth_mb_per_h, [7] * 60)}).report()["core"]
    assert report["unique_mb_per_h"] == pytest.approx(growth_mb_per_h, abs=0.01)
    assert report["resident_mb_per_h"] == pytest.approx(2 * growth_mb_per_h, abs=0.01)


def test_growth_during_the_warm_up_does_not_count() -> None:
    warming, steady = samples(100.0, [7] * 12), samples(0.0, [7] * 60)[12:]
    assert Watch({"core": warming + steady}).report()["core"]["unique_mb_per_h"] == pytest.approx(0, abs=0.01)


def test_restarted_process_has_no_slope() -> None:
    report = Watch({"small": samples(1.0, [7] * 30 + [8] * 30)}).report()["small"]
    assert report["processes_seen"] == 2
    assert "unique_mb_per_h" not in report


def test_decreasing_counter_is_a_violation() -> None:
    watch = Watch()
    for value in (1, 5, 5, 4):
        watch.note_counter("relay", "routed", value)
    assert watch.violations == ["relay: routed went from 5 back to 4"]
