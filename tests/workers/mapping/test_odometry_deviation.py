"""How far odometry may be off is learnt from matches, as far as these know it."""

from copy import deepcopy

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.workers.mapping.odometry_deviation import OdometryDeviation, first_guess
from robbie_robots.workers.planar_pose import compose, relative

KNOWN = np.ones(3)
ASKEW = np.radians(1.0)
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
    # Each step of 0.5 m ends with its error of the heading: 0.45 m times 0.05, 0.1 and 0.15 rad to the right.
    assert noise.corrected([2.0, 0.0, 0.0]) == pytest.approx([1.8, -0.135, -0.2], abs=0.02)
    assert noise.over(STEP)[0] < 0.2 * first_guess(STEP)[0]
    unseen = driven(0.002, np.array([0.0, 1.0, 1.0]), scale=-0.1)
    assert abs(unseen.systematic[0]) < 0.005


def test_angle_by_which_the_laser_is_mounted_wrong_is_learnt() -> None:
    """A laser 1 degree askew bent the map of a real building of 0.8 km by 2 m, where odometry had 0.1 m."""
    noise, random = OdometryDeviation(), np.random.default_rng(0)
    for _ in range(300):
        turn = random.choice([-0.3, 0.0, 0.3])
        step, mounting = np.array([STEP[0], 0.0, turn]), [0.0, 0.0, -ASKEW]
        seen = relative(mounting, compose(step, mounting)) + 0.002 * random.standard_normal(3)
        noise.learn(step, seen, np.abs(step), KNOWN)
    assert noise.systematic[1] == pytest.approx(ASKEW, abs=0.002)


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
    assert abs(noise.systematic[3]) < 0.03


def in_arcs(turns: NDArray[np.float64], per_rad: float = 0.0) -> OdometryDeviation:
    """Odometry that errs by a share of each turn, and matches that are off by 4 mm and 4 mrad."""
    noise, random, before = OdometryDeviation(), np.random.default_rng(0), np.zeros(3)
    for turn in turns:
        after = 0.004 * random.standard_normal(3) * [1, 0, 1]
        step = np.array([STEP[0], 0.0, turn])
        matched = step * [1, 1, 1 + per_rad] + after - before
        noise.learn(step, matched, np.abs(step), np.full(3, 0.98))
        before = after
    return noise


def test_arcs_to_one_side_show_no_error_that_is_not_there() -> None:
    """The turns' noise alone seemed to tell an error with each rad from one with each metre."""
    noise = in_arcs(np.full(600, 0.2))
    assert np.abs(noise.systematic) == pytest.approx(np.zeros(4), abs=0.02)


def test_left_arcs_teach_little_of_right_ones() -> None:
    noise = in_arcs(np.full(600, 0.2))
    left, right = (noise.over([0.5, 0.0, turn], [0.5, 0.0, 0.2])[2] for turn in (0.2, -0.2))
    assert left < 0.006
    assert right > 0.02


def test_turns_to_both_sides_show_how_much_each_rad_is_off() -> None:
    noise = in_arcs(0.2 * np.sign(np.sin(np.arange(600) / 10)), per_rad=0.05)
    assert noise.systematic == pytest.approx([0, 0, 0, 0.05], abs=0.01)
    assert noise.over([0.5, 0.0, -0.2])[2] < 0.006


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
