"""Frontiers are found, paths to them are planned, and unreachable goals are given up."""

import numpy as np
import pytest

from robbie_robots.workers.exploration.exploration import ExplorationSettings, FrontierExploration, PlanResult
from robbie_robots.workers.exploration.frontiers import find_frontiers
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.path_planner import PathField, costs_between
from tests._support.present import present
from tests.workers._support.exploration_world import CLEARANCE_M, RESOLUTION_M, drawn_cells, drawn_grid

# A character is 0.25 m: a room of 3.5 m by 1.5 m, open to the unknown at the right and at the upper left.
TWO_WAYS_ON = """
###    ########
#......#.......
#..............
#..............
#..............
#..............
#......#.......
###############
"""
CLOSED = TWO_WAYS_ON.replace("    ", "####").replace(".\n", "#\n")
LEFT, RIGHT = (0.825, 1.025, 0.0), (3.225, 1.025, 0.0)


def nearest_wall_m(grid: NavigationGrid, path: np.ndarray) -> float:
    return min(float(grid.obstacle_distance_m[grid.cell(point)]) for point in path)


def test_frontiers_lie_between_free_and_unknown() -> None:
    frontiers = find_frontiers(drawn_grid(TWO_WAYS_ON), 0.4)
    assert [round(frontier.length_m, 2) for frontier in frontiers] == [1.5, 1.0]
    right, upper = (frontier.middle_xy_m for frontier in frontiers)
    assert right == pytest.approx([3.725, 1.0], abs=0.05)
    assert upper == pytest.approx([1.25, 1.725], abs=0.05)


def test_completely_known_room_has_no_frontier() -> None:
    assert find_frontiers(drawn_grid(CLOSED), 0.1) == []


def test_gaps_between_beams_are_not_frontiers() -> None:
    cells = drawn_cells(CLOSED)
    cells[10:30, 30:32] = -1
    assert find_frontiers(NavigationGrid(cells, RESOLUTION_M, (0, 0), CLEARANCE_M), 0.1) == []
    cells[10:30, 30:33] = -1
    assert find_frontiers(NavigationGrid(cells, RESOLUTION_M, (0, 0), CLEARANCE_M), 0.1) != []


def test_short_frontiers_are_ignored() -> None:
    assert len(find_frontiers(drawn_grid(TWO_WAYS_ON), 1.2)) == 1


@pytest.mark.parametrize(("pose", "goal"), [(LEFT, (1.25, 1.5)), (RIGHT, (3.7, 1.0))])
def test_near_frontier_is_the_goal(pose: tuple[float, float, float], goal: tuple[float, float]) -> None:
    plan = FrontierExploration().plan_exploration(drawn_grid(TWO_WAYS_ON), pose)
    assert plan.result is PlanResult.GO
    assert np.hypot(*(present(plan.goal_xy_m) - goal)) < 0.35


def test_path_begins_at_the_robot_and_keeps_its_clearance() -> None:
    grid = drawn_grid(TWO_WAYS_ON)
    plan = FrontierExploration().plan_exploration(grid, RIGHT)
    assert np.hypot(*(plan.path[0] - RIGHT[:2])) < RESOLUTION_M
    assert np.hypot(*np.diff(plan.path, axis=0).T).max() <= RESOLUTION_M * 1.42
    assert nearest_wall_m(grid, plan.path) >= CLEARANCE_M


def test_shortest_path_in_free_space_has_the_length_for_eight_neighbours() -> None:
    grid = NavigationGrid(np.zeros((101, 101), dtype=np.int8), RESOLUTION_M, (0, 0), CLEARANCE_M)
    start = grid.cell((0.525, 0.525))
    ways = PathField(grid, start)
    assert ways.cost_m[grid.cell((4.525, 0.525))] == pytest.approx(4.0)
    assert ways.cost_m[grid.cell((4.525, 4.525))] == pytest.approx(4.0 * np.sqrt(2))
    assert ways.cost_m[grid.cell((2.525, 4.525))] == pytest.approx(2.0 * np.sqrt(2) + 2.0)


def test_costs_between_places_are_those_of_the_paths_from_each_of_them() -> None:
    drawn = np.zeros((100, 100), dtype=np.int8)
    drawn[50] = 100
    walled = NavigationGrid(drawn, RESOLUTION_M, (0, 0), CLEARANCE_M)
    cells = [walled.cell(place) for place in ((1.0, 1.0), (4.0, 1.5), (1.0, 4.0))]
    costs_m = costs_between(walled, cells)
    expected = [[PathField(walled, one).cost_m[other] for other in cells] for one in cells]
    assert costs_m == pytest.approx(np.array(expected))
    assert np.isfinite(costs_m[0, 1])
    assert np.isinf(costs_m[0, 2])


def test_path_leads_through_the_door_of_a_wall() -> None:
    cells = np.zeros((100, 100), dtype=np.int8)
    cells[50, :80] = 100
    grid = NavigationGrid(cells, RESOLUTION_M, (0, 0), CLEARANCE_M)
    path = grid.middles_m(PathField(grid, grid.cell((1.0, 1.0))).path(grid.cell((1.0, 4.0))))
    assert path[:, 0].max() > 4.0
    assert nearest_wall_m(grid, path) >= CLEARANCE_M


def test_no_path_leads_through_a_door_too_narrow_for_the_robot() -> None:
    cells = np.zeros((100, 100), dtype=np.int8)
    cells[50] = 100
    cells[50, 45:54] = 0  # 0.45 m
    grid = NavigationGrid(cells, RESOLUTION_M, (0, 0), CLEARANCE_M)
    ways = PathField(grid, grid.cell((1.0, 1.0)))
    beyond = grid.cell((1.0, 4.0))
    assert np.isinf(ways.cost_m[beyond])
    with pytest.raises(ValueError, match="no path"):
        ways.path(beyond)


def test_robot_slightly_inside_the_clearance_still_finds_a_path() -> None:
    plan = FrontierExploration().plan_exploration(drawn_grid(TWO_WAYS_ON), (0.4, 0.4, 0.0))
    assert plan.result is PlanResult.GO


def test_robot_far_from_every_drivable_place_has_no_path() -> None:
    plan = FrontierExploration().plan_exploration(drawn_grid(TWO_WAYS_ON), (9.0, 9.0, 0.0))
    assert plan.result is PlanResult.NO_WAY


def test_room_without_frontiers_is_explored() -> None:
    plan = FrontierExploration().plan_exploration(drawn_grid(CLOSED), LEFT)
    assert plan.result is PlanResult.EXPLORED
    assert plan.goal_xy_m is None


def test_unreachable_frontier_behind_a_window_is_given_up() -> None:
    """The robot sees through a gap of 0.25 m it can never pass."""
    window = CLOSED.replace("####", "# ##", 1)
    grid = drawn_grid(window)
    assert find_frontiers(grid, 0.2) != []
    settings = ExplorationSettings(min_frontier_m=0.2, near_frontier_m=0.2)
    assert FrontierExploration(settings).plan_exploration(grid, LEFT).result is PlanResult.EXPLORED


def test_abandoned_goal_is_not_chosen_again() -> None:
    grid = drawn_grid(TWO_WAYS_ON)
    exploration = FrontierExploration()
    first = present(exploration.plan_exploration(grid, LEFT).goal_xy_m)
    exploration.give_up_goal()
    second = present(exploration.plan_exploration(grid, LEFT).goal_xy_m)
    assert np.hypot(*(first - second)) > 1.0
    exploration.give_up_goal()
    assert exploration.plan_exploration(grid, LEFT).result is PlanResult.EXPLORED


def test_number_of_abandoned_goals_is_bounded() -> None:
    exploration = FrontierExploration(ExplorationSettings(max_avoided=1))
    grid = drawn_grid(TWO_WAYS_ON)
    for _ in range(5):
        assert exploration.plan_exploration(grid, LEFT).result is PlanResult.GO
        exploration.give_up_goal()
    assert len(exploration.avoided_xy_m) == 1


def test_goal_is_kept_while_another_one_is_only_slightly_better() -> None:
    grid = drawn_grid(TWO_WAYS_ON)
    left_first, right_first = FrontierExploration(), FrontierExploration()
    left_first.plan_exploration(grid, LEFT)
    right_first.plan_exploration(grid, RIGHT)
    # From one place in between, both go on to where they were going.
    between = (2.3, 1.0, 1.6)
    kept = [present(e.plan_exploration(grid, between).goal_xy_m)[0] for e in (left_first, right_first)]
    assert kept[0] < 2.0 < kept[1]


def test_map_may_grow_and_its_corner_may_move() -> None:
    exploration = FrontierExploration()
    plain = exploration.plan_exploration(drawn_grid(TWO_WAYS_ON), LEFT).path
    cells = np.pad(drawn_cells(TWO_WAYS_ON), 40, constant_values=-1)
    moved = NavigationGrid(cells, RESOLUTION_M, (-2.0, -2.0), CLEARANCE_M)
    np.testing.assert_allclose(exploration.plan_exploration(moved, LEFT).path, plain)


def test_unknown_map_has_no_path_and_causes_no_error() -> None:
    nothing = NavigationGrid(np.full((50, 50), -1, dtype=np.int8), RESOLUTION_M, (0, 0), CLEARANCE_M)
    assert FrontierExploration().plan_exploration(nothing, LEFT).result is PlanResult.NO_WAY


def test_path_home_ends_at_home() -> None:
    plan = FrontierExploration().plan_way_to(drawn_grid(TWO_WAYS_ON), RIGHT, LEFT[:2])
    assert np.hypot(*(present(plan.goal_xy_m) - LEFT[:2])) < RESOLUTION_M
    assert plan.cost_m >= 2.4
