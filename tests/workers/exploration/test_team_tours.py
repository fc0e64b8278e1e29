"""Tours of a team: each target has one robot, and the last robot is home early."""

from collections.abc import Sequence
from itertools import chain, pairwise, permutations, product

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.exploration.team_tours import SUM_SHARE, TourCosts, share_targets

Points = NDArray[np.float64]


def away_m(first: Points, second: Points) -> Points:
    distances: Points = np.hypot(*(first[:, None] - second[None]).transpose(2, 0, 1))
    return distances


def costs_of(
    robots: list[tuple[float, float]],
    targets: list[tuple[float, float]],
    homes: list[tuple[float, float]] | None = None,
    claimed: tuple[int | None, ...] = (None, None),
) -> TourCosts:
    """Robots on open ground, at home unless said otherwise."""
    here, there = np.array(robots, float), np.array(targets, float).reshape(-1, 2)
    home = here if homes is None else np.array(homes, float)
    back_m = np.hypot(*(here - home).T)
    work_m = np.ones(len(there))
    return TourCosts(away_m(here, there), away_m(there, there), away_m(home, there), back_m, work_m, claimed)


def length_m(costs: TourCosts, robot: int, tour: Sequence[int]) -> float:
    if not tour:
        return float(costs.back_m[robot])
    between_m = sum(float(costs.between_m[one, two]) for one, two in pairwise(tour))
    ends_m = float(costs.begin_m[robot, tour[0]] + costs.end_m[robot, tour[-1]])
    return between_m + ends_m + float(costs.work_m[list(tour)].sum())


def cost_m(costs: TourCosts, tours: Sequence[Sequence[int]]) -> float:
    lengths = [length_m(costs, robot, tour) for robot, tour in enumerate(tours)]
    return max(lengths) + SUM_SHARE * sum(lengths)


def least_cost_m(costs: TourCosts) -> float:
    """The best plan of two robots, by trying all."""
    targets = range(len(costs.work_m))
    plans = []
    for owners in product((0, 1), repeat=len(costs.work_m)):
        best = []
        for robot in (0, 1):
            own = [target for target in targets if owners[target] == robot]
            lengths = {tour: length_m(costs, robot, tour) for tour in permutations(own)}
            best.append(min(lengths, key=lengths.__getitem__))
        plans.append(cost_m(costs, best))
    return min(plans)


def test_robots_part_and_each_visits_its_side() -> None:
    costs = costs_of([(0, 0), (1, 0)], [(-2, 0), (-4, 0), (3, 0), (5, 0)])
    assert [sorted(tour) for tour in share_targets(costs)] == [[0, 1], [2, 3]]


def test_robot_far_from_home_leaves_the_rest_to_the_one_that_is_home_sooner() -> None:
    target = [(5.0, 0.0)]
    near_home = costs_of([(4.0, 0.0), (6.0, 0.0)], target, homes=[(0.0, 0.0), (20.0, 0.0)])
    assert share_targets(near_home) == [[0], []]
    assert share_targets(costs_of([(4.0, 0.0), (6.0, 0.0)], target, homes=[(-20.0, 0.0), (6.0, 0.0)])) == [
        [],
        [0],
    ]


def test_targets_on_one_side_are_shared_when_one_robot_would_take_much_longer() -> None:
    tours = share_targets(costs_of([(0, 0), (0, 0.5)], [(1, y) for y in range(-6, 8, 2)]))
    assert sorted(chain(*tours)) == list(range(7))
    assert min(len(tour) for tour in tours) >= 3


def test_robot_keeps_the_target_that_it_drives_to_unless_another_is_much_nearer() -> None:
    def owner(blue_x_m: float) -> int:
        costs = costs_of([(0, 0), (blue_x_m, 0)], [(4, 0)], claimed=(0, None), homes=[(0, 0), (8, 0)])
        return int(share_targets(costs)[1] == [0])

    assert owner(7.9) == 0
    assert owner(5.0) == 1


def test_target_without_a_way_for_one_robot_belongs_to_the_other() -> None:
    costs = costs_of([(0, 0), (9, 0)], [(1, 0)])
    costs.begin_m[0, 0] = np.inf
    assert share_targets(costs) == [[], [0]]


def test_no_targets_make_empty_tours() -> None:
    assert share_targets(costs_of([(0, 0), (1, 0)], [])) == [[], []]


def test_plans_are_almost_as_good_as_the_best() -> None:
    random = np.random.default_rng(4)
    ratios = []
    for _ in range(15):
        places = random.uniform(0.0, 8.0, (7, 2)).tolist()
        costs = costs_of(places[:2], places[2:], homes=[(0.0, 0.0), (1.0, 0.0)])
        ratios.append(cost_m(costs, share_targets(costs)) / least_cost_m(costs))
    assert min(ratios) >= 1.0 - 1e-9
    assert max(ratios) < 1.15
    assert np.mean(ratios) < 1.03
