"""Localization of robots that know only the map."""

from dataclasses import replace

import numpy as np
import pytest

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.random_rooms import drawn_map, random_rooms
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.localization.likelihood_field import LikelihoodField, MapWithoutRoom
from robbie_robots.workers.localization.localizer import Localizer
from tests._support.present import present
from tools.trials.driving import localization
from tools.trials.driving.localization import Conditions, DrivenRobot, run_trial

SMALL = Conditions(width_m=8.0, height_m=6.0)


@pytest.mark.slow
def test_robot_is_found_anywhere_and_again_after_it_was_moved() -> None:
    trial = run_trial(0, SMALL, limit_m=20.0, kidnap=True)
    assert trial.way_m is not None
    assert present(trial.worst_m) < 0.15
    assert trial.recovery_m is not None


@pytest.mark.slow
def test_robot_with_a_short_view_ahead_is_found_in_a_large_building() -> None:
    trial = run_trial(3, Conditions(20.0, 12.0, range_m=4.0, view_deg=180.0), limit_m=20.0, kidnap=False)
    assert trial.way_m is not None
    assert present(trial.worst_m) < 0.15


def test_pose_is_never_certain_in_a_room_with_fourfold_symmetry(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    walls = np.array([(0, 0, 6, 0), (6, 0, 6, 6), (0, 0, 0, 6), (0, 6, 6, 6)], float)
    square = Arena(walls, np.empty((0, 3)), Pose(2.0, 2.5, 0.3), 6.0, 6.0)
    monkeypatch.setattr(localization, "random_rooms", lambda *_: square)
    drive = DrivenRobot(0, Conditions(6.0, 6.0))
    for _ in drive.steps(4.0):
        assert not present(drive.localizer.newest).converged
    assert present(drive.localizer.newest).spread_rad > 0.5


def test_same_inputs_and_seed_give_the_same_poses() -> None:
    poses = []
    for _ in range(2):
        drive = DrivenRobot(1, SMALL)
        poses.append(np.array([drive.localizer.pose for _ in drive.steps(0.3)]))
    assert np.array_equal(poses[0], poses[1])


def test_particles_are_bounded_and_fewer_once_the_robot_is_found() -> None:
    drive = DrivenRobot(1, SMALL)
    counts = []
    for _ in drive.steps(2.0):
        assert len(present(drive.localizer._cloud)) <= drive.localizer.settings.max_particles
        counts.append(present(drive.localizer.newest).particles)
    assert counts[0] == drive.localizer.settings.max_particles
    assert counts[-1] < 1_000


def test_given_pose_is_used_and_rejected_if_the_laser_contradicts_it() -> None:
    drive = DrivenRobot(2, SMALL)
    truth = drive.arena.start
    drive.localizer.start_at(truth)
    for pose in drive.steps(0.2):
        assert drive.off_m(pose) < 0.3
    drive.localizer.start_at((truth.x_m + 2.0, truth.y_m, truth.heading_rad))
    assert drive.way_until_sure(20.0) is not None


def test_restarted_localizer_continues_while_the_robot_stands() -> None:
    drive = DrivenRobot(1, SMALL)
    for _ in drive.steps(2.0):
        pass
    old = drive.localizer
    assert present(old.newest).converged
    drive.localizer = Localizer(old.field)
    drive.localizer.restore(old.state())
    truth = next(drive.steps(1.0))
    assert present(drive.localizer.newest).converged
    assert drive.off_m(truth) < 0.1


def test_sweeps_without_returns_are_ignored() -> None:
    drive = DrivenRobot(1, SMALL)
    drive.localizer.add_odometry(0.0, (0, 0, 0))
    drive.localizer.add_scan(0.0, LaserSweep.from_ranges(np.full(360, np.inf), 0.0, 0.01, 0.05, 10.0))
    assert drive.localizer.pose is None


def test_beams_through_walls_are_detected() -> None:
    arena = random_rooms(0, 8.0, 6.0)
    cells, corner = drawn_map(arena)
    field = LikelihoodField(cells, 0.05, corner)
    angles = np.radians(np.arange(0, 360, 12))
    ranges = arena.ranges_m(arena.start.x_m, arena.start.y_m, angles + arena.start.heading_rad)
    beams = np.column_stack([np.cos(angles), np.sin(angles)])
    here = np.array([arena.start])
    assert field.blocked(here, ranges[:, None] * beams) < 0.1
    assert field.blocked(here, (ranges[:, None] + 0.6) * beams) == 1.0
    assert field.log_likelihoods(here, ranges[:, None] * beams) > field.log_likelihoods(here, beams)


@pytest.mark.parametrize("percent", [-1, 0, 100])
def test_map_without_free_or_occupied_cells_is_refused(percent: int) -> None:
    with pytest.raises(MapWithoutRoom, match="free and occupied"):
        LikelihoodField(np.full((5, 5), percent, dtype=np.int8), 0.05, (0, 0))


def test_certain_pose_keeps_its_weight_where_things_hide_a_part_of_the_map(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drive = DrivenRobot(2, SMALL)
    assert drive.way_until_sure(20.0) is not None
    add_scan, recoveries = drive.localizer.add_scan, drive.localizer.recoveries

    def with_things_at_one_side(stamp_s: float, sweep: LaserSweep) -> None:
        nearer = np.where(np.arange(len(sweep)) % 180 < 70, 0.7, 1.0)
        add_scan(stamp_s, replace(sweep, ranges_m=nearer * sweep.ranges_m))

    monkeypatch.setattr(drive.localizer, "add_scan", with_things_at_one_side)
    for truth in drive.steps(1.0):
        assert drive.is_right(truth)
        assert present(drive.localizer._cloud).heaviest_cluster().weight > 0.9
    assert drive.localizer.recoveries > recoveries
