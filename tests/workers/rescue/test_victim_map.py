"""Views of victims are fused, and the operator is asked only about victims that are known well."""

import numpy as np
import pytest

from robbie_robots.workers.rescue.victim_map import VictimMap, VictimState

PATCH = np.zeros((4, 4, 3), np.uint8)


def test_near_views_have_more_weight_than_far_ones() -> None:
    victims = VictimMap()
    victims.see(3, (5.0, 1.0, 0.3), 0.0, 4.0, 1.0, PATCH)
    victim = victims.see(3, (5.2, 1.0, 0.3), 0.0, 1.0, 2.0, PATCH)
    assert victim.position_m[0] == pytest.approx(5.2, abs=0.02)
    assert victim.best_m == 1.0


def test_more_views_reduce_the_spread_down_to_that_of_the_robots_pose() -> None:
    victims = VictimMap()
    spreads = []
    for number in range(50):
        victim = victims.see(3, (5.0, 1.0, 0.3), 0.0, 1.0, float(number), PATCH)
        spreads.append(victim.spread_m)
    assert spreads == sorted(spreads, reverse=True)
    assert spreads[-1] >= 0.03
    assert 0.99 < victim.confidence <= 1.0


def test_one_view_of_another_place_is_ignored_but_several_are_accepted() -> None:
    victims = VictimMap()
    for number in range(4):
        victims.see(3, (5.0, 1.0, 0.3), 0.0, 1.0, float(number), PATCH)
    assert victims.see(3, (9.0, 1.0, 0.3), 0.0, 1.0, 5.0, PATCH).position_m[0] == 5.0
    victims.see(3, (9.0, 1.0, 0.3), 0.0, 1.0, 6.0, PATCH)
    assert victims.see(3, (9.0, 1.0, 0.3), 0.0, 1.0, 7.0, PATCH).position_m[0] == 9.0


def test_facing_is_averaged_correctly_across_plus_minus_pi() -> None:
    victims = VictimMap()
    victims.see(3, (5.0, 1.0, 0.3), 3.1, 1.0, 1.0, PATCH)
    victim = victims.see(3, (5.0, 1.0, 0.3), -3.1, 1.0, 2.0, PATCH)
    assert abs(victim.facing_rad) == pytest.approx(np.pi, abs=0.01)


@pytest.mark.parametrize(
    ("distance_m", "views", "known"), [(1.0, 4, True), (1.0, 3, False), (2.5, 20, False)]
)
def test_victim_is_known_well_after_enough_near_views(distance_m: float, views: int, known: bool) -> None:
    victims = VictimMap()
    for number in range(views):
        victim = victims.see(3, (5.0, 1.0, 0.3), 0.0, distance_m, float(number), PATCH)
    assert victims.is_known_well(victim) is known


def test_everything_survives_a_restart() -> None:
    victims = VictimMap()
    victims.see(3, (5.0, 1.0, 0.3), 0.5, 1.0, 1.0, PATCH).state = VictimState.REJECTED
    again = VictimMap()
    again.restore(victims.state())
    assert again.victims[3].state is VictimState.REJECTED
    assert repr(again.victims) == repr(victims.victims)
