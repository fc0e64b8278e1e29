"""Driving to goals, around obstacles, and the treatment of unreachable goals."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from robbie_mp.base.state_machine import mermaid
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.maps.navigation_grid import NavigationGrid
from robbie_robots.workers.navigation.collision_guard import CollisionGuard
from robbie_robots.workers.navigation.costmap import LiveCostmap
from robbie_robots.workers.navigation.live_obstacles import LiveObstacles
from robbie_robots.workers.navigation.navigator import Navigator
from robbie_robots.workers.navigation.navigator_states import TRANSITIONS, NavigatorSettings, NavigatorState
from robbie_robots.workers.navigation.path_follower import HALT
from robbie_robots.workers.navigation.way_planner import Obstruction, plan_way
from tests.docs._support.pages import ROOT
from tests.workers._support.exploration_world import drawn_cells
from tests.workers._support.navigation_world import NavigationWorld, demo_arena

ANGLES = (-np.pi, np.pi / 180)
ROOM = "##########\n#........#\n#........#\n#........#\n##########"


def seen(ranges: ArrayLike) -> LaserSweep:
    return LaserSweep.from_ranges(ranges, *ANGLES, 0.05, 10.0)


def with_circles(arena: Arena, *circles: Sequence[float]) -> Arena:
    return replace(arena, circles=np.vstack([arena.circles, circles]))


def test_robot_drives_through_two_rooms_and_turns_to_the_goals_heading() -> None:
    world, goal = NavigationWorld(demo_arena()), (7.0, 1.0, 1.5)
    world.navigator.go_to(goal)
    world.run(60.0)
    assert world.states == ["DRIVE", "ALIGN", "ARRIVED"], world.navigator.status
    assert world.off_m(goal) < 0.2
    assert world.drive.ground_truth().pose.heading_rad == pytest.approx(1.5, abs=0.2)
    assert world.drive.collisions == 0
    assert world.navigator.drive() is None


def test_robot_drives_around_obstacles_that_are_not_on_the_map() -> None:
    arena = demo_arena()
    blocked = with_circles(arena, [3.3, 2.1, 0.2], [4.6, 2.75, 0.15])
    world, goal = NavigationWorld(arena, blocked), (6.8, 2.4, 0.0)
    world.navigator.go_to(goal)
    world.run(60.0)
    assert world.navigator.state is NavigatorState.ARRIVED, world.navigator.status
    assert world.off_m(goal) < 0.2
    assert world.drive.collisions == 0


@pytest.mark.parametrize(
    ("goal", "reason"),
    [
        ((0.9, 5.0, 0.0), "the goal lies in or too near to an obstacle"),
        ((20.0, 1.0, 0.0), "the goal lies in unknown space"),
    ],
)
def test_undrivable_goal_is_given_up_at_once(goal: tuple[float, float, float], reason: str) -> None:
    world = NavigationWorld(demo_arena())
    world.navigator.go_to(goal)
    world.run(2.0)
    assert world.navigator.state is NavigatorState.UNREACHABLE
    assert reason in world.navigator.machine.reason


@pytest.mark.parametrize("enters_unknown", [True, False])
def test_robot_drives_through_places_that_it_has_not_seen_only_if_it_may(enters_unknown: bool) -> None:
    arena, goal = demo_arena(), (7.0, 1.0, 1.5)
    world = NavigationWorld(arena, settings=NavigatorSettings(enters_unknown=enters_unknown))
    seen_cells = int((3.0 - world.corner[0]) / 0.05)
    world.navigator.see_map(world.cells[:, :seen_cells], 0.05, world.corner)  # the goal is far beyond it
    world.navigator.go_to(goal)
    world.run(90.0)
    if not enters_unknown:
        assert "the goal lies in unknown space" in world.navigator.machine.reason
        return
    assert world.navigator.state is NavigatorState.ARRIVED, world.navigator.status
    assert world.off_m(goal) < 0.2
    assert world.drive.collisions == 0


@pytest.mark.parametrize("is_open", [True, False])
def test_robot_drives_through_a_door_that_is_open_though_the_map_shows_it_closed(is_open: bool) -> None:
    walls = [(4.0, 0.0, 4.0, 1.5), (4.0, 2.5, 4.0, 4.0), *box_segments(np.array([(0.0, 0.0, 8.0, 4.0)]))]
    opened = Arena(np.array(walls), np.empty((0, 3)), Pose(2.5, 2.0, 0.0), 8.0, 4.0)
    closed = replace(opened, segments=np.vstack([walls, [(4.0, 1.5, 4.0, 2.5)]]))
    settings = NavigatorSettings(enters_unknown=True)
    world, goal = NavigationWorld(closed, opened if is_open else closed, settings), (6.0, 2.0, 0.0)
    world.navigator.go_to(goal)
    world.run(30.0)
    if not is_open:
        assert world.navigator.state is NavigatorState.UNREACHABLE, world.navigator.status
        return
    assert world.navigator.state is NavigatorState.ARRIVED, world.navigator.status
    assert world.off_m(goal) < 0.2
    assert world.drive.collisions == 0


def test_goal_too_far_beyond_the_map_is_given_up_though_the_robot_enters_unknown_places() -> None:
    world = NavigationWorld(demo_arena(), settings=NavigatorSettings(enters_unknown=True))
    world.navigator.go_to((1e6, 1.0, 0.0))
    world.run(2.0)
    assert world.navigator.state is NavigatorState.UNREACHABLE


def test_goal_behind_a_wall_without_a_door_is_given_up() -> None:
    arena = demo_arena()
    closed = replace(arena, segments=np.vstack([arena.segments, [(0, 1.6, 8, 1.6)]]))
    world = NavigationWorld(closed)
    known = np.where(world.cells < 0, 0, world.cells)  # the map knows the rooms behind the wall
    world.navigator.see_map(known, 0.05, world.corner)
    world.navigator.go_to((7.0, 1.0, 0.0))
    world.run(2.0)
    assert world.navigator.machine.reason == "no path leads to the goal"


@pytest.mark.parametrize("goal_x_m", [1.0, 3.0])
def test_robot_in_a_narrow_place_gets_out_on_either_side(goal_x_m: float) -> None:
    cells = np.zeros((60, 80), dtype=np.int8)
    cells[:, 39:41] = 100
    cells[25:35, 39:41] = 0  # 0.5 m wide: on this map nobody would drive in
    grid = NavigationGrid(cells, 0.05, (0.0, 0.0), NavigatorSettings().clearance_m)
    way = plan_way(grid, (1.95, 1.5, 0.0), (goal_x_m, 1.5), snap_m=0.4, tolerance_m=0.25)
    assert way.obstruction is Obstruction.NONE
    assert abs(way.path[0][0] - 1.95) < 0.4
    assert way.path[-1][0] == pytest.approx(goal_x_m, abs=0.05)
    elsewhere = plan_way(grid, (1.0, 1.5, 0.0), (3.0, 1.5), snap_m=0.4, tolerance_m=0.25)
    assert elsewhere.obstruction is Obstruction.NO_WAY


def test_robot_drives_through_a_tight_gap_if_no_other_path_exists() -> None:
    arena = demo_arena()
    gap = [(0, 1.6, 2.0, 1.6), (2.56, 1.6, 8, 1.6)]
    world = NavigationWorld(replace(arena, segments=np.vstack([arena.segments, gap])))
    goal = (2.3, 0.8, 0.0)
    narrow = plan_way(
        NavigationGrid(world.cells, 0.05, world.corner, NavigatorSettings().clearance_m),
        world.drive.ground_truth().pose, goal[:2], snap_m=0.4, tolerance_m=0.25,
    )  # fmt: skip
    assert narrow.obstruction is Obstruction.NO_WAY
    world.navigator.go_to(goal)
    world.run(60.0)
    assert world.navigator.state is NavigatorState.ARRIVED, world.navigator.status
    assert world.drive.collisions == 0


def test_goal_behind_a_lasting_block_is_given_up_after_all_recoveries() -> None:
    arena = demo_arena()
    gates = [[x_m, 1.62, 0.1] for left_m in (2.25, 4.75) for x_m in np.arange(left_m, left_m + 1.5, 0.2)]
    settings = NavigatorSettings(max_recoveries=3)
    world = NavigationWorld(arena, with_circles(arena, *gates), settings)
    world.navigator.go_to((7.0, 1.0, 0.0))
    world.run(60.0)
    assert {"CLEAR_COSTMAP", "BACK_UP", "ROTATE"} <= set(world.states)
    assert world.navigator.state is NavigatorState.UNREACHABLE
    assert "3 recovery attempts failed" in world.navigator.machine.reason
    assert world.drive.collisions == 0


@pytest.mark.parametrize(
    ("sense", "state"), [("laser_works", "STOPPED_NO_LASER"), ("pose_works", "STOPPED_NO_POSE")]
)
def test_robot_stops_while_it_has_no_scans_and_then_drives_on(sense: str, state: str) -> None:
    world = NavigationWorld(demo_arena())
    world.navigator.go_to((7.0, 1.0, 0.0))
    world.run(3.0)
    assert world.drive.read().linear_m_per_s > 0.2
    setattr(world, sense, False)
    world.run(2.0)
    assert world.navigator.state.name == state
    assert " for 0." in world.navigator.machine.reason
    assert world.drive.read().linear_m_per_s == 0.0
    assert world.navigator.drive() == HALT
    setattr(world, sense, True)
    world.run(1.5)
    assert world.navigator.state is NavigatorState.DRIVE
    assert world.drive.read().linear_m_per_s > 0.2


def test_emergency_stop_stops_the_robot_and_keeps_the_goal() -> None:
    world = NavigationWorld(demo_arena())
    world.navigator.go_to((7.0, 1.0, 0.0))
    world.run(2.0)
    world.navigator.see_emergency_stop("somebody pressed the button")
    world.run(1.0)
    assert world.navigator.state is NavigatorState.EMERGENCY_STOP
    assert "somebody pressed the button" in world.navigator.status
    assert world.drive.read().linear_m_per_s == 0.0
    world.navigator.see_emergency_stop("")
    world.run(1.5)
    assert world.drive.read().linear_m_per_s > 0.2


def test_newer_goal_replaces_the_older_one() -> None:
    world = NavigationWorld(demo_arena())
    world.navigator.go_to((7.0, 1.0, 0.0))
    world.run(1.0)
    world.navigator.go_to((2.5, 2.4, 0.0))
    world.run(30.0)
    assert world.navigator.state is NavigatorState.ARRIVED
    assert world.off_m((2.5, 2.4)) < 0.2


def test_obstacles_are_kept_while_hidden_and_removed_when_looked_through() -> None:
    obstacles = LiveObstacles(decay_s=10.0)
    ranges = np.full(360, 3.0)
    ranges[175:186] = 1.0
    obstacles.see((0, 0, 0), seen(ranges), 0.0)
    assert np.abs(obstacles.points(0.0) - (1.0, 0.0)).max(axis=1).min() < 0.05
    obstacles.see((0, 0, np.pi / 2), seen(np.full(360, np.inf)), 5.0)
    before = len(obstacles.points(5.0))
    assert before > 0
    obstacles.see((0, 0, 0), seen(np.full(360, 3.0)), 6.0)
    assert np.hypot(*obstacles.points(6.0).T).min() > 2.5
    assert len(obstacles.points(17.0)) == 0


def test_obstacles_of_two_lasers_add_up_and_what_one_has_seen_long_ago_opens_nothing() -> None:
    obstacles = LiveObstacles()
    half = np.full(180, 3.0)
    ahead, rear = (LaserSweep.from_ranges(half, -np.pi / 2, np.pi / 180, 0.05, 10.0) for _ in range(2))
    places = np.array([[2.0, 0.0], [-2.0, 0.0], [0.0, 3.5]])
    obstacles.see((0, 0, 0), ahead, 0.0)
    assert obstacles.sees_through(places).tolist() == [True, False, False]
    obstacles.see((0, 0, np.pi), rear, 0.05, "rear")
    assert obstacles.sees_through(places).tolist() == [True, True, False]
    assert np.abs(obstacles.points(0.1)).max(axis=0) == pytest.approx([3.0, 3.0], abs=0.05)
    obstacles.see((0, 0, 0), ahead, 2.0)
    assert obstacles.sees_through(places).tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("rear_m", "rear_s", "back"),
    [(2.0, 0.0, -0.15), (0.08, 0.0, 0.0), (2.0, 1.0, 0.0), (None, 0.0, 0.0)],
    ids=["free", "blocked", "stale", "silent"],
)
def test_robot_backs_up_only_where_a_fresh_sweep_of_its_rear_laser_shows_free_ground(
    rear_m: float | None, rear_s: float, back: float
) -> None:
    now_s, half = 10.0, np.full(180, 3.0)
    angles = -np.pi / 2, np.pi / 180
    navigator = Navigator(lambda: now_s, CollisionGuard(), further_lasers=["rear_scan"])
    navigator.see_map(np.zeros((200, 200), np.int8), 0.05, (-5.0, -5.0))
    navigator.see_pose((0, 0, 0), now_s, now_s)
    navigator.see_sweep(LaserSweep.from_ranges(half, *angles, 0.05, 10.0), now_s, now_s)
    if rear_m is not None:
        rear = np.full(180, rear_m)
        sweep = LaserSweep.from_ranges(rear, *angles, 0.05, 10.0)
        navigator.see_further_sweep("rear_scan", (-0.175, 0.0, np.pi), sweep, now_s - rear_s, now_s - rear_s)
    navigator.go_to((1.5, 0.0, 0.0))
    speeds = navigator.drive()
    assert speeds is not None and speeds[0] > 0.0, "it drives on without its rear laser"
    navigator.machine.go(NavigatorState.BACK_UP, "for a test")
    assert navigator.drive() == pytest.approx((back, 0.0))
    is_silent = rear_m is None or rear_s > 0.0
    assert navigator.silent == ["rear_scan"] * is_silent
    assert ("no fresh scan of rear_scan" in navigator.status) is is_silent


def test_backing_up_rests_on_the_stamp_of_the_rear_laser_and_not_on_when_it_was_told() -> None:
    now_s, half = 10.0, np.full(180, 3.0)
    sweep = LaserSweep.from_ranges(half, -np.pi / 2, np.pi / 180, 0.05, 10.0)
    navigator = Navigator(lambda: now_s, CollisionGuard(), further_lasers=["rear_scan"])
    navigator.see_pose((0, 0, 0), now_s, now_s)
    navigator.see_sweep(sweep, now_s - 0.1, now_s)
    navigator.see_further_sweep("rear_scan", (-0.175, 0.0, np.pi), sweep, now_s - 5.0, now_s)
    navigator.go_to((1.5, 0.0, 0.0))
    assert navigator.rests_on_s == pytest.approx(9.9)
    navigator.machine.go(NavigatorState.BACK_UP, "for a test")
    assert navigator.rests_on_s == pytest.approx(5.0)


def test_live_obstacles_are_bounded() -> None:
    obstacles = LiveObstacles(most=500)
    for number in range(20):
        obstacles.see((number, 0, 0), seen(np.full(360, 2.0)), float(number))
    assert len(obstacles) == 500


def test_costmap_adds_seen_obstacles_and_keeps_the_walls() -> None:
    costmap = LiveCostmap(drawn_cells(ROOM), 0.05, (0.0, 0.0), 0.1)
    obstacles = LiveObstacles()
    obstacles.see((1.0, 0.6, 0.0), seen(np.full(360, 0.28)), 0.0)  # most of it is within the walls' vicinity
    grid = costmap.grid(obstacles, 0.0)
    assert not grid.drivable[grid.cell((1.28, 0.6))]
    assert costmap.static_grid.drivable[grid.cell((1.28, 0.6))]
    far_off = LiveObstacles()
    far_off.see((100.0, 0.0, 0.0), seen(np.full(360, 1.0)), 0.0)
    assert costmap.grid(far_off, 0.0) is costmap.static_grid


def test_state_diagram_in_the_documentation_matches_the_code() -> None:
    page = (ROOT / "docs" / "navigation.md").read_text()
    assert mermaid(NavigatorState.IDLE, TRANSITIONS, NavigatorSettings().time_outs()) in page


def test_robot_leaves_a_corridor_that_is_too_narrow_on_its_map() -> None:
    # 0.57 m wide: it came in while the map showed one of the walls only.
    arena = demo_arena()
    walls = [(1.0, 2.0, 3.0, 2.0), (1.0, 2.57, 3.0, 2.57), (1.0, 2.0, 1.0, 2.57)]
    narrow = replace(arena, segments=np.vstack([arena.segments, walls]), start=Pose(1.3, 2.285, 0.0))
    world, goal = NavigationWorld(narrow), (4.5, 2.3, 0.0)
    world.navigator.go_to(goal)
    world.run(60.0)
    assert world.navigator.state is NavigatorState.ARRIVED, world.navigator.status
    assert world.drive.collisions == 0


def test_cells_under_the_robot_are_free_even_if_occupied_on_the_map() -> None:
    cells = np.zeros((40, 40), dtype=np.int8)
    cells[18:23, 18:23] = 100
    grid = NavigationGrid(cells, 0.05, (0.0, 0.0), 0.27)
    here = (1.025, 1.025)
    assert not grid.drivable[grid.cell(here)]
    around = grid.around_robot(here, body_radius_m=0.2, clearance_m=0.22)
    assert around.drivable[around.cell(here)]
    assert around.drivable.shape == grid.drivable.shape
    assert not grid.drivable[grid.cell(here)]


def test_only_what_stands_on_free_ground_of_the_map_may_move() -> None:
    costmap = LiveCostmap(drawn_cells(ROOM), 0.05, (0.0, 0.0), 0.27)
    height, width = (size * 0.05 for size in drawn_cells(ROOM).shape)
    middle, at_wall, outside = (width / 2, height / 2), (0.25, height / 2), (width + 1.0, height / 2)
    assert costmap.shows_free(np.array([middle, at_wall, outside])).tolist() == [True, False, False]
