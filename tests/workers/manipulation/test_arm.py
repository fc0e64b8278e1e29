"""The arm's kinematics agree with the scene graph, and its ways touch nothing."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from robbie_mp.scene import SceneGraph, read_scene
from robbie_robots.workers.manipulation.arm_model import ArmModel, Floats
from robbie_robots.workers.manipulation.collisions import CollisionWorld, Shape
from robbie_robots.workers.manipulation.errors import Unreachable, WrongArm
from robbie_robots.workers.manipulation.planning import plan, reach, straight_line
from robbie_robots.workers.manipulation.trajectory import Trajectory
from tests._support.places import PROJECT

pytest.importorskip("pinocchio", reason="arms need the extra 'arm'")

ROBOT = PROJECT / "hw/robots/home.urdf"
JOINTS = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_pitch", "wrist_roll"]
DRIVES = np.array([0.0, -0.8, -0.3, 0.0, 1.1, 0.0])


def box(name: str, size: tuple[float, float, float], x: float, y: float, z: float) -> Shape:
    pose = np.eye(4)
    pose[:3, 3] = (x, y, z)
    return Shape(name, size, pose)


TABLE = box("table", (0.6, 1.2, 0.4), 0.6, 0.0, 0.2)
POST = box("post", (0.05, 0.05, 0.5), 0.42, 0.0, 0.65)


@pytest.fixture(scope="module")
def arm() -> ArmModel:
    return ArmModel(ROBOT, JOINTS, ["gripper", "right_finger"])


def free_positions(surroundings: CollisionWorld, count: int, seed: int) -> list[Floats]:
    chance = np.random.default_rng(seed)
    found: list[Floats] = []
    while len(found) < count:
        positions = surroundings.arm.random(chance)
        if not surroundings.collides(positions):
            found.append(positions)
    return found


def densely(way: Floats) -> Floats:
    """Positions on a way, 0.005 rad apart."""
    pieces = [
        np.linspace(one, other, int(np.abs(other - one).max() / 0.005) + 2)
        for one, other in itertools.pairwise(way)
    ]
    return np.concatenate(pieces)


def test_forward_kinematics_are_those_of_the_scene_graph(arm: ArmModel) -> None:
    graph = SceneGraph(read_scene(ROBOT))
    chance = np.random.default_rng(3)
    for time_ns in range(1, 21):
        positions = arm.random(chance)
        for name, position in zip(JOINTS, positions.tolist(), strict=True):
            graph.set_joint(name, time_ns, position)
        expected = graph.pose("base_link", "grasp_point").matrix
        np.testing.assert_allclose(arm.pose(positions), expected, atol=1e-9)
    assert arm.max_speed.tolist() == [graph.joint(name).max_speed for name in JOINTS]


@pytest.mark.slow
def test_all_of_200_random_reachable_poses_are_solved_without_a_collision(arm: ArmModel) -> None:
    surroundings = CollisionWorld(arm, [TABLE])
    chance = np.random.default_rng(0)
    for positions in free_positions(surroundings, 200, seed=1):
        goal = arm.pose(positions)
        found = reach(arm, surroundings, goal, DRIVES, chance)
        np.testing.assert_allclose(arm.pose(found), goal, atol=2e-3)
        assert arm.is_within_limits(found)
        assert not surroundings.collides(found)


def test_planned_ways_touch_nothing_however_densely_one_looks(arm: ArmModel) -> None:
    around = [TABLE, POST]
    surroundings, exact = CollisionWorld(arm, around), CollisionWorld(arm, around, margin_m=0.0)
    chance = np.random.default_rng(0)
    ends = free_positions(surroundings, 11, seed=2)
    detours = 0
    for begin, end in itertools.pairwise(ends):
        way = plan(surroundings, begin, end, chance)
        np.testing.assert_array_equal(way[[0, -1]], [begin, end])
        detours += len(way) > 2
        assert not any(exact.collides(positions) for positions in densely(way))
    assert detours >= 3  # or the test shows nothing


def test_what_is_held_keeps_away_from_obstacles_too(arm: ArmModel) -> None:
    stick = Shape("stick", (0.03, 0.03, 0.4), np.eye(4))
    low = np.array([0.0, 0.45, 0.45, 0.0, -0.9, 0.0])
    # The hand is ahead, 7 cm above the table; the stick is upright in it.
    assert arm.pose(low)[2, 3] == pytest.approx(0.47, abs=0.03)
    assert not CollisionWorld(arm, [TABLE]).collides(low)
    held = CollisionWorld(arm, [TABLE], held=stick)
    assert held.collides(low)
    assert held.touching(low) == [("stick", "table")]


def test_hand_moves_straight_and_says_where_it_cannot_go_on(arm: ArmModel) -> None:
    surroundings = CollisionWorld(arm, [TABLE])
    goal = arm.pose(DRIVES)
    goal[:3, 3] = (0.45, 0.0, 0.6)
    begin = reach(arm, surroundings, goal, DRIVES, np.random.default_rng(0))
    goal[0, 3] += 0.08
    way = straight_line(arm, surroundings, begin, goal)
    places = np.array([arm.pose(positions)[:3, 3] for positions in densely(way)])
    assert np.abs(places[:, 1:] - [0.0, 0.6]).max() < 0.002
    np.testing.assert_allclose(arm.pose(way[-1]), goal, atol=2e-3)
    goal[2, 3] = 0.38
    with pytest.raises(Unreachable, match=r"touches something after 0.*table"):
        straight_line(arm, surroundings, way[-1], goal)


def test_unreachable_poses_get_an_error_that_says_why(arm: ArmModel) -> None:
    chance, surroundings = np.random.default_rng(0), CollisionWorld(arm, [TABLE])
    goal = np.eye(4)
    goal[:3, 3] = (1.5, 0.0, 0.5)
    with pytest.raises(Unreachable, match=r"cannot bring its hand to \(1\.500, 0\.000, 0\.500\)"):
        reach(arm, surroundings, goal, DRIVES, chance, restarts=10)
    goal[:3, 3] = (0.5, 0.0, 0.39)
    with pytest.raises(Unreachable, match=r"would touch something: \w+ and table"):
        reach(arm, surroundings, goal, DRIVES, chance, restarts=30)
    inside = reach(arm, CollisionWorld(arm), goal, DRIVES, chance)
    with pytest.raises(Unreachable, match="touches something where it should be"):
        plan(surroundings, DRIVES, inside, chance)


def test_robot_that_lacks_a_joint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WrongArm, match="no joint 'wasit'"):
        ArmModel(ROBOT, ["wasit"], ["gripper"])
    with pytest.raises(WrongArm, match="no link 'tool'"):
        ArmModel(ROBOT, JOINTS, ["gripper"], tip="tool")
    file = tmp_path / "robot.urdf"
    file.write_text("<robot>")
    with pytest.raises(WrongArm, match="cannot read the robot"):
        ArmModel(file, JOINTS, ["gripper"])


def test_trajectory_keeps_the_limits_of_the_joints_and_ends_at_rest() -> None:
    way = np.array([[0.0, 0.0], [0.5, 0.1], [0.6, 0.12], [0.2, 0.9]])
    max_speed, max_acceleration = np.array([1.0, 0.5]), np.array([2.0, 2.0])
    trajectory = Trajectory(way, max_speed, max_acceleration)
    times = np.arange(0.0, trajectory.duration_s + 0.1, 0.001)
    at = np.array([trajectory.at(time_s) for time_s in times])
    speeds = np.diff(at, axis=0) / 0.001
    assert (np.abs(speeds).max(axis=0) <= max_speed + 1e-6).all()
    assert np.abs(speeds).max(axis=0) == pytest.approx([0.98, 0.5], abs=0.15)
    assert np.abs(np.diff(speeds, axis=0)).max() / 0.001 <= 2.0 + 1e-3
    np.testing.assert_allclose(at[[0, -1]], way[[0, -1]])
    # It passes each corner.
    assert all(np.abs(at - corner).max(axis=1).min() < 1e-3 for corner in way)
    standing = Trajectory(way[:1], max_speed, max_acceleration)
    assert standing.duration_s == 0.0
    np.testing.assert_array_equal(standing.at(1.0), way[0])
