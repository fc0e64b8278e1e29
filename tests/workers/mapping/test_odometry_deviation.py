"""How far odometry may be off is learnt from matches, as far as these know it."""

from copy import deepcopy

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.workers.mapping.odometry_deviation import OdometryDeviation, first_guess

KNOWN = np.ones(3)
STEP = np.array([0.5, 0.0, 0.0])


def driven(
    error: float, known: NDArray[np.float64], steps: int = 600, scale: float = 0.0
) -> OdometryDeviation:
    """Matches that find odometry off by a share of each step, along and in heading."""
    noise, random = OdometryDeviation(), np.random.default_rng(0)
    for _ in range(steps):
        off = error * random.standard_normal(2) + scale * STEP[0]
        noise.learn(STEP, STEP + known * [off[0], 0.0, off[1]], STEP, known)
    return noise


def test_unknown_odometry_counts_as_uncalibrated() -> None:
    assert OdometryDeviation().over(STEP) == pytest.approx(first_guess(STEP), rel=0.02)


def test_good_odometry_is_trusted_more_in_the_end_and_bad_odometry_less() -> None:
    assert driven(0.005, KNOWN).over(STEP)[0] < 0.2 * first_guess(STEP)[0]
    assert driven(0.2, KNOWN).over(STEP)[0] > 1.2 * first_guess(STEP)[0]


def test_good_odometry_is_soon_trusted_more() -> None:
    assert driven(0.005, KNOWN, steps=30).over(STEP)[0] < 0.5 * first_guess(STEP)[0]


def test_what_a_match_does_not_know_teaches_nothing() -> None:
    noise = driven(0.0, np.array([0.0, 1.0, 1.0]))
    assert noise.share[0] == pytest.approx(1.0, abs=0.02)
    assert noise.share[2] < 0.3


def test_systematic_error_is_learnt_and_is_no_noise() -> None:
    noise = driven(0.002, KNOWN, scale=-0.1)
    assert noise.corrected([2.0, 0.0, 0.0]) == pytest.approx([1.8, 0.0, -0.2], abs=0.02)
    assert noise.over(STEP)[0] < 0.2 * first_guess(STEP)[0]
    unseen = driven(0.002, np.array([0.0, 1.0, 1.0]), scale=-0.1)
    assert abs(unseen.systematic[0]) < 0.005


def test_straight_way_teaches_nothing_of_turns() -> None:
    """The robot turned in place by odometry alone: 0.12 rad off in each scan, and sure of 0.005 rad."""
    noise = driven(0.002, KNOWN)
    assert noise.over([0.0, 0.0, 0.5])[2] > 0.03
    assert noise.over(STEP)[2] < 0.2 * first_guess(STEP)[2]


def test_noise_of_straight_way_is_no_systematic_error_of_turns() -> None:
    """Odometry's own turns on a straight way are its noise, so correcting them all seemed best."""
    noise, random = OdometryDeviation(), np.random.default_rng(0)
    for turn in 0.02 * random.standard_normal(600):
        noise.learn(STEP + np.array([0.0, 0.0, turn]), STEP, STEP, KNOWN)
    assert abs(noise.systematic[2]) < 0.03


def test_noise_is_bounded_and_one_wrong_match_changes_little() -> None:
    assert driven(50.0, KNOWN).share.max() <= 1.5
    noise = driven(0.005, KNOWN)
    before = noise.share
    for _ in range(3):
        noise.learn(STEP, STEP + np.array([1.0, 0.0, 0.5]), STEP, KNOWN)
    assert (noise.share < 1.5 * before).all()
    assert np.abs(noise.systematic).max() < 0.02


def test_restored_noise_goes_on_alike() -> None:
    noise, restored = driven(0.01, KNOWN, steps=31), OdometryDeviation()
    restored.restore(deepcopy(noise.state()))
    for one in (noise, restored):
        one.learn(STEP, STEP, STEP, KNOWN)
        one.learn(STEP, STEP, STEP, KNOWN)
    assert np.array_equal(noise.share, restored.share)
    assert np.array_equal(noise.systematic, restored.systematic)
