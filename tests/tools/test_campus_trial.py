"""A drive through a small campus is mapped whole, and the trial notices what is missing."""

from dataclasses import replace

import numpy as np
import pytest

from tools.trials.driving.campus import MOST_END_ERROR_M, Campus, CampusResult, trial


@pytest.fixture(scope="module")
def result() -> CampusResult:
    return trial(14.0, 10.0, 1, seed=0)


@pytest.mark.slow
def test_small_campus_is_mapped_with_every_sweep(result: CampusResult) -> None:
    assert not result.violations()
    assert result.loops_closed > 0
    assert result.end_error_m < 0.1
    assert min(result.map_m) >= 13
    assert max(result.map_m) >= 17


@pytest.mark.slow
def test_trial_fails_if_a_sweep_is_missing_or_the_end_is_wrong(result: CampusResult) -> None:
    assert replace(result, refused={"sweeps beyond the grid's memory": 1}).violations()
    assert replace(result, thinned=1).violations()
    assert replace(result, end_error_m=2 * MOST_END_ERROR_M).violations()


def test_course_drives_every_loop_and_returns_to_the_start() -> None:
    course = Campus(500, 300, 3, seed=0).course()
    assert np.array_equal(course[0], course[-1])
    assert set(course[:, 0].round()) == {0, 167, 333, 500}
    steps = np.diff(course, axis=0)
    assert (np.minimum(*np.abs(steps).T) == 0).all()
    assert 2500 < np.abs(steps).sum() < 3500
