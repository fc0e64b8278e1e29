"""Following a path, and the last check against the newest sweep."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep, MountedSweep
from robbie_robots.workers.navigation.collision_guard import CollisionGuard, GuardSettings
from robbie_robots.workers.navigation.path_follower import HALT, FollowerSettings, PathFollower, Velocity
from robbie_robots.workers.navigation.progress_watch import ProgressWatch

GUARD = GuardSettings()
STRAIGHT = np.column_stack([np.linspace(0, 3, 61), np.zeros(61)])


def taken(ranges: ArrayLike, first_deg: float = -180.0, step_deg: float = 1.0) -> LaserSweep:
    return LaserSweep.from_ranges(ranges, math.radians(first_deg), math.radians(step_deg), 0.05, 10.0)


def sweep(distance_m: float = np.inf, at_deg: int = 0, width_deg: int = 1) -> LaserSweep:
    """A sweep that sees one thing, or nothing."""
    ranges = np.full(360, np.inf)
    ranges[np.arange(at_deg, at_deg + width_deg) + 180 - width_deg // 2] = distance_m
    return taken(ranges)


def near(*sweeps: LaserSweep, mount: Sequence[float] = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    return CollisionGuard().near_points(MountedSweep(one, mount) for one in sweeps)


def checked(seen: LaserSweep, linear: float = 0.5, angular: float = 0.0) -> Velocity:
    return CollisionGuard().checked(near(seen), (linear, angular))


def drive_along(
    follower: PathFollower, pose: tuple[float, float, float], seconds: float, step_s: float = 0.05
) -> NDArray[np.float64]:
    """Return the poses of a robot that obeys at once."""
    poses = [pose]
    for _ in range(round(seconds / step_s)):
        linear, angular = follower.velocity(pose)
        heading = pose[2] + angular * step_s
        pose = (
            pose[0] + linear * step_s * math.cos(heading),
            pose[1] + linear * step_s * math.sin(heading),
            heading,
        )
        poses.append(pose)
    return np.array(poses)


def test_follower_without_a_path_stops() -> None:
    follower = PathFollower()
    assert follower.velocity((0, 0, 0)) == HALT
    assert not follower.is_arrived((0, 0, 0))


def test_follower_drives_straight_on_a_straight_path() -> None:
    follower = PathFollower()
    follower.follow(STRAIGHT)
    assert follower.velocity((0, 0, 0)) == pytest.approx((FollowerSettings().max_linear_m_per_s, 0.0))


@pytest.mark.parametrize("side", [1, -1])
def test_follower_turns_on_the_spot_towards_a_path_behind_it(side: int) -> None:
    follower = PathFollower()
    follower.follow(STRAIGHT)
    linear, angular = follower.velocity((0, 0, side * 2.5))
    assert linear == 0.0
    assert angular * side < 0
    assert follower.is_turning


@pytest.mark.parametrize("pose", [(0.0, 0.3, 0.0), (0.0, -0.3, 2.0), (-0.2, 0.0, -3.0)])
def test_follower_reaches_the_end_from_beside_the_path(pose: tuple[float, float, float]) -> None:
    follower = PathFollower()
    follower.follow(STRAIGHT)
    poses = drive_along(follower, pose, 12.0)
    assert follower.is_arrived(poses[-1])
    assert follower.velocity(poses[-1]) == HALT
    on_the_way = poses[(poses[:, 0] > 1.0) & (poses[:, 0] < 3.0)]
    assert np.abs(on_the_way[:, 1]).max() < 0.1


def test_follower_continues_after_a_jump_of_the_pose() -> None:
    follower = PathFollower()
    follower.follow(STRAIGHT)
    pose = drive_along(follower, (0, 0, 0), 2.0)[-1]
    poses = drive_along(follower, tuple(pose + np.array([-0.1, 0.15, 0.2])), 10.0)
    assert follower.is_arrived(poses[-1])


def test_follower_respects_its_limits() -> None:
    follower = PathFollower()
    follower.follow([(0, 0), (0.2, 0.2), (0.0, 0.4), (0.2, 0.6)])
    limits = FollowerSettings()
    for heading in np.linspace(-np.pi, np.pi, 50):
        linear, angular = follower.velocity((0.05, 0.1, heading))
        assert 0.0 <= linear <= limits.max_linear_m_per_s
        assert abs(angular) <= limits.max_angular_rad_per_s + 1e-9


def test_guard_allows_driving_in_free_space() -> None:
    assert checked(sweep(), 0.5, 0.3) == (0.5, 0.3)


def test_guard_stops_before_an_obstacle() -> None:
    assert checked(sweep(0.26)) == (0.0, 0.0)


def test_guard_leaves_room_to_stop_at_every_distance() -> None:
    for distance_m in np.linspace(0.26, 1.5, 60):
        linear, _ = checked(sweep(distance_m))
        way_m = linear * GUARD.reaction_s + linear**2 / (2 * GUARD.deceleration_m_per_s2)
        assert way_m <= distance_m - GUARD.body_radius_m - GUARD.margin_m + 1e-9


def test_guard_slows_down_more_near_obstacles() -> None:
    speeds = [checked(sweep(distance_m))[0] for distance_m in (0.3, 0.4, 0.5, 1.2)]
    assert speeds == sorted(speeds)
    assert len(set(speeds)) == len(speeds)


def test_guard_keeps_the_arc_when_it_slows_down() -> None:
    linear, angular = checked(sweep(0.42), 0.5, 0.2)
    assert 0.0 < linear < 0.5
    assert angular / linear == pytest.approx(0.4)


def test_guard_allows_turning_where_driving_is_blocked() -> None:
    assert checked(sweep(0.22), 0.5, 0.7) == (0.0, 0.7)
    assert checked(sweep(0.22), 0.0, 0.7) == (0.0, 0.7)


def test_guard_checks_along_the_arc_and_not_only_ahead() -> None:
    left, guard = near(sweep(0.6, at_deg=45, width_deg=5)), CollisionGuard()
    assert guard.free_way_m(left, 0.5, 0.0) == GUARD.look_m
    assert guard.free_way_m(left, 0.5, 1.0) < 0.5


def test_guard_checks_behind_when_driving_backwards() -> None:
    assert checked(sweep(0.26, at_deg=-180), -0.2) == (0.0, 0.0)
    assert checked(sweep(0.26, at_deg=0), -0.2)[0] < 0.0


def test_robot_that_is_too_near_may_only_drive_away() -> None:
    too_near = sweep(0.22, at_deg=0)
    assert checked(too_near, 0.2)[0] == 0.0
    assert checked(too_near, -0.2)[0] < 0.0


def test_guard_stops_for_obstacles_too_near_to_measure() -> None:
    assert checked(sweep(-np.inf)) == (0.0, 0.0)


def test_guard_does_not_stop_for_missing_returns() -> None:
    assert checked(taken(np.tile([np.nan, np.inf], 180))) == (0.5, 0.0)


def test_robot_keeps_more_distance_from_what_may_move_and_uses_half_of_the_way_to_it() -> None:
    guard, points = CollisionGuard(), near(sweep(0.75))
    assert len(points) == 1
    loose = np.array([True])
    assert guard.free_way_m(points, 0.5, 0.0, ~loose) == guard.free_way_m(points, 0.5, 0.0)
    half_m = (0.75 - GUARD.body_radius_m - GUARD.margin_m - GUARD.loose_margin_m) / 2
    assert guard.free_way_m(points, 0.5, 0.0, loose) == pytest.approx(half_m, abs=0.031)
    assert guard.checked(points, (0.5, 0.0), loose)[0] < guard.checked(points, (0.5, 0.0))[0]
    assert guard.checked(near(sweep(0.32)), (0.2, 0.0), loose) == (0.0, 0.0)
    beside = near(sweep(0.34, at_deg=90))
    assert guard.checked(beside, (0.5, 0.0), loose)[0] < guard.checked(beside, (0.5, 0.0))[0]


def test_guard_accounts_for_the_lasers_mounting_pose() -> None:
    guard = CollisionGuard()
    ahead = near(sweep(0.4), mount=(0.15, 0.0, 0.0))
    assert guard.free_way_m(ahead, 0.5, 0.0) == pytest.approx(0.4 + 0.15 - 0.25, abs=0.031)
    turned = near(sweep(0.4, at_deg=-180), mount=(0.0, 0.0, math.pi))
    assert guard.free_way_m(turned, 0.5, 0.0) == pytest.approx(0.4 - 0.25, abs=0.031)


def test_guard_checks_what_only_one_of_two_lasers_sees() -> None:
    guard, behind = CollisionGuard(), np.full(180, np.inf)
    behind[90] = 0.125  # 0.1 m from the body
    ahead = MountedSweep(taken(np.full(180, np.inf), -90.0))
    both = guard.near_points([ahead, MountedSweep(taken(behind, -90.0), (-0.175, 0.0, math.pi))])
    assert guard.checked(guard.near_points([ahead]), (-0.3, 0.0)) == (-0.3, 0.0)
    assert -0.2 < guard.checked(both, (-0.3, 0.0))[0] < 0.0
    slowed = GUARD.crawl_m_per_s + GUARD.speed_per_room_per_s * 0.1
    assert guard.checked(both, (0.5, 0.0))[0] == pytest.approx(slowed)


@pytest.mark.parametrize(("x_m", "edge_m"), [(-0.175, 0.2), (-0.25, 0.25)])
def test_what_is_too_near_to_a_laser_to_measure_touches_the_body_there(x_m: float, edge_m: float) -> None:
    guard, points = CollisionGuard(), near(taken([-np.inf], 0.0), mount=(x_m, 0.0, math.pi))
    assert points == pytest.approx(np.array([[-edge_m, 0.0]]))
    assert guard.checked(points, (-0.3, 0.0)) == (0.0, 0.0)
    assert guard.checked(points, (0.3, 0.0))[0] > 0.0, "it can drive away"


@pytest.mark.parametrize("first_deg", [-180, -90, 0, 90])
def test_guard_looks_where_each_sweep_looks_though_another_had_as_many_beams(first_deg: int) -> None:
    guard, ranges = CollisionGuard(), np.full(360, np.inf)
    ranges[-first_deg % 360] = 0.3  # ahead
    assert guard.checked(near(sweep(0.3, at_deg=90)), (0.3, 0.0))[0] > 0.0
    assert guard.checked(near(taken(ranges, first_deg)), (0.3, 0.0)) == checked(sweep(0.3), 0.3)


@pytest.mark.parametrize("beams", [359, 360, 361, 367, 90, 2, 1])
def test_guard_takes_another_number_of_beams_with_each_sweep(beams: int) -> None:
    for ahead in (0, beams - 1):
        ranges = np.full(beams, np.inf)
        ranges[ahead] = 0.26
        assert checked(taken(ranges, -ahead * 0.98, 0.98)) == (0.0, 0.0)
        assert checked(taken(ranges, 180.0 - ahead * 0.98, 0.98))[0] > 0.0


def test_guard_sees_through_an_upside_down_laser() -> None:
    ranges = np.full(360, np.inf)
    ranges[90] = 0.3  # 90 degrees to the right
    assert near(taken(ranges, 0.0, -1.0)) == pytest.approx(np.array([[0.0, -0.3]]))


def test_guard_believes_the_nearest_of_overlapping_beams() -> None:
    ranges = np.full(400, np.inf)
    ranges[380] = 0.26
    assert checked(taken(ranges, -20.0)) == (0.0, 0.0)


def test_guard_without_sweeps_has_no_points() -> None:
    assert near().shape == near(taken([])).shape == (0, 2)


def test_progress_is_a_shorter_path_to_the_same_goal() -> None:
    watch = ProgressWatch(step_m=0.1)
    assert watch.idle_s((1, 1), 3.0, 10.0) == 0.0
    assert watch.idle_s((1, 1), 2.95, 12.0) == 2.0
    assert watch.idle_s((1.1, 1), 2.8, 13.0) == 0.0
    assert watch.idle_s((1, 1), 4.0, 15.0) == 2.0


def test_new_goal_restarts_the_measurement() -> None:
    watch = ProgressWatch()
    watch.idle_s((1, 1), 1.0, 10.0)
    assert watch.idle_s((5, 1), 9.0, 15.0) == 0.0
    watch.restart()
    assert watch.idle_s((5, 1), 9.0, 18.0) == 0.0
