"""Odometry adds up arcs, and becomes less certain with the way."""

import math

import numpy as np
import pytest

from robbie_robots.hw.odometry import Odometer, OdometryNoise


def test_square_ends_where_it_began() -> None:
    odometer = Odometer()
    for _ in range(4):
        odometer.add(2.0, 0.0)
        odometer.add(0.0, math.pi / 2)
    assert odometer.pose.x_m == pytest.approx(0.0, abs=1e-9)
    assert odometer.pose.y_m == pytest.approx(0.0, abs=1e-9)


def test_straight_way_is_less_certain_to_the_side_than_ahead() -> None:
    odometer = Odometer()
    for _ in range(100):
        odometer.add(0.1, 0.0)
    along, aside, heading = np.diag(odometer.covariance)
    assert along == pytest.approx(10 * 0.0004)
    assert heading == pytest.approx(10 * 0.0005)
    # The integral of heading's variance over the way still to go: 0.0005 * 10^3 / 3.
    assert aside == pytest.approx(0.5 / 3, rel=0.02)


def test_covariance_is_that_of_many_noisy_robots() -> None:
    noise = OdometryNoise(distance=0.0005, heading=0.001, heading_for_distance=0.0005)
    random = np.random.default_rng(1)
    arcs = [(0.2, 0.1)] * 30
    odometer = Odometer(noise)
    for arc in arcs:
        odometer.add(*arc)
    ends = []
    for _ in range(400):
        robot = Odometer()
        for distance_m, turn_rad in arcs:
            spread = noise.heading * abs(turn_rad) + noise.heading_for_distance * distance_m
            noisy_m = distance_m + random.normal(0, math.sqrt(noise.distance * distance_m))
            robot.add(noisy_m, turn_rad + random.normal(0, math.sqrt(spread)))
        ends.append((robot.pose.x_m, robot.pose.y_m))
    np.testing.assert_allclose(np.cov(np.array(ends).T), odometer.covariance[:2, :2], rtol=0.3, atol=0.002)
