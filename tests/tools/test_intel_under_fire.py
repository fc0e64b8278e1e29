"""The verdict on the Intel run with kills."""

import dataclasses

import pytest

from tools.trials.recordings.intel_under_fire import Outcome, spread, violations

CALM = Outcome(0, 30.0, 14541, 910, 910, 0, 0, 0, 0.0406, 1.58, 2984)
KILLS = {"mapping": 5, "core": 3}
FIRE = dataclasses.replace(CALM, scans=908, scans_lost=2, lost=5, restarts=KILLS)


def test_one_lost_message_per_kill_of_mapping_is_not_a_violation() -> None:
    assert violations(CALM, FIRE, KILLS) == []


@pytest.mark.parametrize(
    "change",
    [
        {"exit_code": 1},
        {"restarts": {"mapping": 5, "core": 2}},
        {"lost": 6},
        {"dropped": 1},
        {"scans": 904},
        {"translation_mean_m": 0.046},
    ],
)
def test_anything_more_is_a_violation(change: dict[str, object]) -> None:
    assert violations(CALM, dataclasses.replace(FIRE, **change), KILLS)  # type: ignore[arg-type]


def test_kills_are_spread_over_the_run() -> None:
    shots = spread(KILLS, 10_000, seed=1)
    moments = [shot.at_handled for shot in shots]
    assert sorted(shot.name for shot in shots) == ["core"] * 3 + ["mapping"] * 5
    assert moments == sorted(moments)
    assert 500 <= moments[0] < 2000
    assert 8000 < moments[-1] <= 9500
