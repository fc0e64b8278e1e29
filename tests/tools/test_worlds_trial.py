"""Generated worlds are as they should be, and their maps are better than odometry."""

import numpy as np
import pytest

from tools.trials.driving.worlds import KINDS, WorldConditions, logged, trial


@pytest.mark.parametrize("kind", KINDS)
def test_conditions_of_each_kind_are_in_range_and_repeatable(kind: str) -> None:
    one, other = (WorldConditions.drawn(kind, np.random.default_rng(5)) for _ in range(2))
    assert one == other
    assert 0.025 <= one.sweep_s <= 3.0
    assert 4.0 <= one.range_m <= 80.0
    assert 25.0 <= one.way_m <= 800.0
    assert 0.005 <= one.drift <= 0.3


def test_log_begins_between_walls_and_odometry_drifts() -> None:
    conditions = WorldConditions.drawn("slips", np.random.default_rng(1))
    log = logged(WorldConditions(**{**vars(conditions), "way_m": 15.0, "sweep_s": 1.0}), seed=1)
    assert len(log.troubles_s) == 2
    assert len(log.true) == len(log.odometry)
    assert all(len(sweep.hits) > 20 for _, sweep in log.sweeps)
    assert np.hypot(*(log.odometry[-1, 1:3] - (log.true[-1, 1:3] - log.true[0, 1:3]))) > 0.1


@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.parametrize("kind", ["corridors", "rare sweeps"])
def test_map_of_a_world_is_much_better_than_its_odometry(kind: str) -> None:
    result = trial(kind, 1 if kind == "rare sweeps" else 0, {"way_m": 150.0})
    assert result.ratio < 0.5
    assert (result.untold, result.false_loops) == (0, 0)


@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.parametrize("seed", [1, 3])
def test_crowd_is_not_taken_for_a_slip(seed: int) -> None:
    """People who walk along with the robot agreed better with the map at a pose 0.1 to 1 m off."""
    assert trial("crowd", seed).error_m < 0.05


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_laser_that_is_mounted_askew_does_not_bend_the_map() -> None:
    """A laser 0.3 degrees askew: the map was 0.073 m off, about as much as odometry."""
    assert trial("askew laser", 0).error_m < 0.03
