"""The mission decides what to do next, and returns home in time."""

from dataclasses import replace

import numpy as np
import pytest

from robbie_mp.base.state_machine import mermaid
from robbie_robots.workers.exploration.frontiers import find_frontiers
from robbie_robots.workers.exploration.team_claims import Claim
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.navigator_states import NavigatorSettings
from robbie_robots.workers.navigation.way_planner import Obstruction, plan_way
from robbie_robots.workers.rescue.mission_states import TIME_OUTS, TRANSITIONS, MissionSettings, MissionState
from robbie_robots.workers.rescue.mission_targets import MissionMap
from robbie_robots.workers.rescue.searched_walls import UNSEARCHED, WallFronts, WallMemory
from robbie_robots.workers.rescue.victim_map import VictimState
from tests._support.places import DOCS
from tests._support.present import present
from tests.workers._support.exploration_world import RESOLUTION_M, drawn_cells
from tests.workers._support.mission_world import HALF_KNOWN, HALL, START, Rescue

S = MissionState


def test_mission_waits_for_the_robots_pose() -> None:
    rescue = Rescue()
    assert rescue.mission.step().goal is None
    assert rescue.state() is S.WAIT


def test_mission_explores_searches_and_comes_home() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.begin()
    states = rescue.drive()
    assert states[-2:] == [S.RETURN, S.DONE]
    assert {S.EXPLORE, S.SEARCH} <= set(states)
    assert rescue.mission.machine.reason == "is home"
    assert rescue.pose[:2] == pytest.approx(START[:2])
    assert rescue.mission.notes == []
    fronts = WallFronts(rescue.cells, RESOLUTION_M, (0.0, 0.0))
    assert rescue.memory.is_searched(fronts).mean() > 0.95


def test_frontier_goal_is_drivable_and_near_unknown_space() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.search_everything()
    orders = rescue.begin()
    assert 1.5 < present(orders.goal)[0] < 2.25
    assert orders.look_at_xy_m is None


def test_work_behind_a_passage_that_navigation_can_use_is_not_overlooked() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.pose = np.array([0.6, 0.8, 0.0])
    rescue.cells[:, 20:25] = 100
    rescue.cells[11:23, 20:25] = 0  # 0.6 m wide
    rescue.search_everything()
    navigation = NavigatorSettings()
    grid = NavigationGrid(rescue.cells, RESOLUTION_M, (0.0, 0.0), navigation.clearance_m)
    way = plan_way(grid, rescue.pose, (1.6, 0.8), navigation.snap_m, navigation.tolerance_m)
    assert way.obstruction is Obstruction.NONE
    assert present(rescue.begin().goal)[0] > 1.25


def test_mission_continues_from_a_passage_that_is_too_narrow_for_paths() -> None:
    cells = np.full((80, 80), -1, dtype=np.int8)
    cells[10:70, 10:70] = 0
    cells[20:60, 28:36] = cells[20:60, 45:53] = 100  # 0.45 m between the walls
    around = MissionMap(cells, RESOLUTION_M, (0.0, 0.0), MissionSettings())
    ways = around.ways_from((40.5 * RESOLUTION_M, 40.5 * RESOLUTION_M, 0.0))
    assert ways is not None
    assert np.isfinite(ways.cost_m[around.grid.cell((0.8, 0.8))])


def test_goals_keep_a_larger_distance_from_obstacles_than_paths() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.cells[5:30, 30:45] = 100
    rescue.cells[11:23, 30:45] = 0  # 0.6 m wide, and dead straight into what is unknown
    rescue.search_everything()
    orders = rescue.begin()
    assert orders.goal is None or orders.goal[0] < 1.5


def test_unreachable_goal_is_not_chosen_again() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.search_everything()
    rescue.begin()
    assert rescue.state() is S.EXPLORE
    goals = []
    while rescue.state() is S.EXPLORE:
        goals.append(tuple(present(rescue.step().goal)[:2]))
        rescue.mission.unreachable("no way leads to the goal")
        for _ in range(3):
            rescue.step()
    assert rescue.state() is S.RETURN
    assert len(goals) == len(set(goals)) < 8


def test_goal_is_kept_while_the_map_shifts_only_slightly() -> None:
    rescue = Rescue(HALF_KNOWN)
    first = rescue.begin().goal
    rescue.cells = np.roll(rescue.cells, 1, axis=1)
    assert np.array_equal(present(rescue.step().goal), present(first))


@pytest.mark.parametrize(("passed_s", "state"), [(70.0, S.EXPLORE), (81.0, S.RETURN), (101.0, S.FAILED)])
def test_mission_turns_back_before_the_time_is_over(passed_s: float, state: S) -> None:
    rescue = Rescue(HALF_KNOWN, time_limit_s=100.0, spare_s=20.0)
    rescue.search_everything()
    rescue.begin()
    rescue.step(passed_s - 1.0)
    assert rescue.state() is state


def test_mission_turns_back_while_the_battery_still_suffices() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.begin()
    for ratio in (1.0, 0.6, 0.2):
        rescue.mission.limits.see_battery(ratio)
        rescue.step(30.0)
    # 0.4 in 30 s: what is above the reserve lasts for less than 15 s.
    assert (rescue.state(), rescue.mission.machine.reason) == (S.RETURN, "the battery is almost empty")


def test_robot_that_cannot_drive_reports_the_reason_and_continues_afterwards() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.begin()
    rescue.mission.see_stopped("STOPPED_NO_LASER: the laser is silent")
    assert rescue.step().goal is None
    assert rescue.state() is S.HALT
    assert "laser is silent" in rescue.mission.status
    rescue.mission.see_stopped(None)
    assert rescue.step().goal is not None
    assert rescue.mission.notes == ["stopped: STOPPED_NO_LASER: the laser is silent"]


def test_robot_that_can_never_drive_again_ends_its_mission_in_time() -> None:
    rescue = Rescue(HALF_KNOWN, time_limit_s=100.0)
    rescue.begin()
    rescue.mission.see_stopped("STOPPED_NO_LASER: the laser is silent")
    rescue.step()
    rescue.step(100.0)
    assert (rescue.state(), rescue.mission.machine.reason) == (S.FAILED, "the time is over")


def test_mission_without_a_camera_continues_without_victims_and_reports_it() -> None:
    rescue = Rescue(HALL)
    rescue.begin()
    assert rescue.state() is S.SEARCH
    rescue.camera_works = False
    rescue.step(10.0)
    rescue.step()
    rescue.step()
    assert rescue.state() is S.RETURN
    assert rescue.mission.notes == ["the camera is silent: the mission continues without victims"]


def test_suspected_victim_is_approached_inspected_and_abandoned_in_vain() -> None:
    rescue = Rescue(HALL)
    rescue.search_everything()
    rescue.tell(VictimState.SUSPECTED)
    orders = rescue.begin()
    assert rescue.state() is S.APPROACH
    assert 0.6 <= np.hypot(*(present(orders.goal)[:2] - (2.0, 1.4))) <= 1.3
    assert orders.look_at_xy_m == pytest.approx([2.0, 1.4])
    rescue.mission.arrived()
    assert rescue.step().goal is None
    assert rescue.state() is S.INSPECT
    rescue.step(TIME_OUTS[S.INSPECT].after_s)
    assert rescue.state() is S.EXPLORE
    assert rescue.drive()[-1] is S.DONE


def test_victim_is_approached_even_where_another_target_was_given_up() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.search_everything()
    rescue.begin()
    x_m, y_m = present(rescue.mission._target).about_xy_m
    rescue.mission.unreachable("no way leads to the goal")
    rescue.tell(VictimState.SUSPECTED, x_m, y_m + 0.2)
    rescue.step()
    assert rescue.state() is S.APPROACH


def test_victim_seen_on_the_way_home_is_approached_once() -> None:
    rescue = Rescue(HALL)
    rescue.search_everything()
    rescue.begin()
    rescue.step()
    rescue.step()
    assert rescue.state() is S.RETURN
    rescue.tell(VictimState.SUSPECTED)
    rescue.step()
    assert rescue.state() is S.APPROACH
    states = rescue.drive()
    assert states[-2:] == [S.RETURN, S.DONE]
    assert states.count(S.RETURN) == 1


def test_robot_looks_at_a_wall_only_as_long_as_necessary() -> None:
    rescue = Rescue(HALL)
    rescue.begin()
    rescue.mission.arrived()
    assert rescue.step(0.2).goal is None
    assert rescue.state() is S.LOOK
    rescue.search_everything()
    rescue.step(0.2)
    assert rescue.mission.machine.reason == "the wall was seen well"


def test_robot_leaves_a_wall_at_once_when_it_was_seen_well() -> None:
    rescue = Rescue(HALL)
    rescue.pose = present(rescue.begin().goal)
    rescue.mission.arrived()
    rescue.step(0.2)
    rescue.memory.look(WallFronts(rescue.cells, RESOLUTION_M, (0.0, 0.0)), rescue.pose, 0.7)
    orders = rescue.step(0.2)
    assert rescue.state() is S.SEARCH
    assert tuple(present(orders.goal)) != tuple(rescue.pose)


def test_robot_waits_only_once_for_each_answer_of_the_operator() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.search_everything()
    rescue.begin()
    rescue.tell(VictimState.ASKED)
    assert rescue.step().goal is None
    assert rescue.state() is S.ASK
    rescue.step(TIME_OUTS[S.ASK].after_s)
    assert rescue.state() is S.EXPLORE
    rescue.tell(VictimState.CONFIRMED)
    rescue.tell(VictimState.ASKED)  # a new question
    rescue.step()
    assert rescue.state() is S.ASK
    rescue.tell(VictimState.REJECTED)
    rescue.step()
    assert rescue.state() is S.EXPLORE


def test_restarted_mission_knows_its_victims_and_that_it_was_returning() -> None:
    rescue = Rescue(HALL, time_limit_s=200.0)
    rescue.search_everything()
    rescue.tell(VictimState.CONFIRMED)
    rescue.begin()
    rescue.step()
    rescue.step()
    assert rescue.state() is S.RETURN
    again = Rescue(HALL, time_limit_s=200.0)
    again.pose = np.array([3.0, 0.8, 0.0])
    again.mission.remember(rescue.mission.memory())
    again.begin()
    assert again.state() is S.RETURN
    assert again.mission.home == pytest.approx(START)
    assert again.mission.victims.reports == rescue.mission.victims.reports
    assert again.mission.limits.used_s == pytest.approx(rescue.mission.limits.used_s, abs=2.0)


def test_state_diagram_in_the_documentation_matches_the_declaration() -> None:
    page = (DOCS / "rescue.md").read_text()
    assert mermaid(S.WAIT, TRANSITIONS, TIME_OUTS) in page


def test_walls_that_were_never_in_view_are_unsearched() -> None:
    grid = WallMemory().grid(WallFronts(drawn_cells(HALL), RESOLUTION_M, (0.0, 0.0)))
    assert set(np.unique(grid).tolist()) == {-1, UNSEARCHED}


def blue(
    target: tuple[float, float] | None, way_m: float = 0.1, *, is_working: bool = True, x_m: float = 3.4
) -> Claim:
    """Return what robot `blue` does, far away unless said otherwise."""
    target_xy_m = None if target is None else np.array(target)
    return Claim(np.array([x_m, 0.8, np.pi]), None, target_xy_m, way_m, is_working)


def test_work_that_another_robot_does_is_left_to_it_until_it_falls_silent() -> None:
    rescue = Rescue(HALF_KNOWN)
    rescue.search_everything()
    grid = NavigationGrid(rescue.cells, RESOLUTION_M, (0.0, 0.0), rescue.mission.settings.clearance_m)
    (frontier,) = find_frontiers(grid, rescue.mission.settings.min_frontier_m)
    x_m, y_m = frontier.middle_xy_m.tolist()
    rescue.mission.claims.see("blue", blue((x_m, y_m)), valid_s=20.0)
    rescue.begin()
    for _ in range(4):
        rescue.step()
    assert (rescue.state(), rescue.mission.machine.reason) == (S.RETURN, "the rest is left to other robots")
    rescue.mission.arrived()
    assert rescue.state() is S.RETURN, "it waits at home: the other one may need help"
    for _ in range(20):
        rescue.step()
    assert rescue.state() is S.EXPLORE


def test_mission_ends_when_no_other_robot_works_any_more() -> None:
    rescue = Rescue()
    rescue.search_everything()
    rescue.mission.claims.see("blue", blue(None), valid_s=100.0)
    rescue.begin()
    for _ in range(5):
        rescue.step()
        rescue.mission.arrived()
    assert rescue.state() is S.RETURN
    rescue.mission.claims.see("blue", blue(None, is_working=False), valid_s=100.0)
    rescue.step()
    rescue.mission.arrived()
    assert rescue.state() is S.DONE


@pytest.mark.parametrize(("gives_way_to", "state"), [(("blue",), S.GIVE_WAY), ((), S.EXPLORE)])
def test_robot_gives_way_only_to_those_that_go_first(gives_way_to: tuple[str, ...], state: S) -> None:
    rescue = Rescue(HALF_KNOWN, gives_way_to=gives_way_to)
    rescue.search_everything()
    rescue.begin()
    assert rescue.state() is S.EXPLORE
    comes = replace(blue(None, x_m=1.8), goal=np.array([0.5, 0.8, np.pi]))
    rescue.mission.claims.see("blue", comes, valid_s=3.0)
    orders = rescue.step()
    assert rescue.state() is state
    assert (orders.goal is None) is (state is S.GIVE_WAY), "there is no room beside the way of blue"
    rescue.step(3.0)
    assert rescue.state() is S.EXPLORE, "the other robot is silent"
