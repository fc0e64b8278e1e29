"""Robots that know one another's targets choose different ones."""

import math

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.exploration.team_claims import DISCOUNT_M, RANGE_M, SAME_M, Claim, TeamClaims

TARGET = np.array([4.0, 1.0])


def east_by(away_m: float) -> NDArray[np.float64]:
    return np.array([TARGET[0] + away_m, TARGET[1]])


def claims_with(way_m: float, target: NDArray[np.float64] | None = TARGET) -> tuple[TeamClaims, list[float]]:
    now_s = [10.0]
    claims = TeamClaims(lambda: now_s[0])
    claims.see("blue", Claim(np.zeros(3), None, target, way_m, is_working=True), valid_s=3.0)
    return claims, now_s


def test_target_is_left_to_the_robot_that_is_nearer_to_it() -> None:
    claims, _ = claims_with(way_m=2.0)
    assert claims.extra_cost_m(east_by(SAME_M / 2), 2.1) == math.inf
    assert claims.extra_cost_m(TARGET, 1.9) == 0.0


def test_target_costs_more_the_nearer_it_lies_to_a_claimed_one() -> None:
    claims, _ = claims_with(way_m=1.0)
    near, far = (claims.extra_cost_m(east_by(away_m), 5.0) for away_m in (1.0, 2.0))
    assert 0.0 < far < near < DISCOUNT_M
    assert claims.extra_cost_m(east_by(RANGE_M + 0.1), 5.0) == 0.0
    assert claims.extra_cost_m(east_by(1.0), 5.0, is_current=True) == 0.0
    assert claims.extra_cost_m(TARGET, 5.0, is_current=True) == math.inf


def test_claim_of_a_silent_robot_expires() -> None:
    claims, now_s = claims_with(way_m=1.0)
    assert claims.is_anyone_working
    now_s[0] += 3.0
    assert claims.extra_cost_m(TARGET, 5.0) == 0.0
    assert not claims.is_anyone_working


def test_robot_without_a_target_claims_nothing() -> None:
    claims, _ = claims_with(way_m=0.0, target=None)
    assert claims.extra_cost_m(TARGET, 5.0) == 0.0


def test_only_robots_that_look_for_work_count() -> None:
    claims, _ = claims_with(way_m=1.0)
    assert len(claims.working) == 1
    claims.see("blue", Claim(np.zeros(3), None, None, 0.0, is_working=False), valid_s=3.0)
    assert claims.working == []
