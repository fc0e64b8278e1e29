"""Poses agree with those of pytransform3d to 1e-9."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pytransform3d import rotations, transformations
from pytransform3d.transform_manager import TransformManager

from robbie_mp.scene import JointType, Node, RigidTransform, SceneGraph
from robbie_mp.scene.rigid_transform import interpolate
from tests.scene._support.strategies import ANGLES, LENGTHS, PATIENT, poses, trees

FEW = settings(PATIENT, max_examples=30)


def assert_close(ours: Any, expected: Any) -> None:
    np.testing.assert_allclose(ours, expected, rtol=0.0, atol=1e-9)


def theirs(pose: RigidTransform) -> Any:
    """As translation and quaternion of pytransform3d, which begins with w."""
    return np.array([*pose[:3], pose.qw, pose.qx, pose.qy, pose.qz])


def their_matrix(pose: RigidTransform) -> Any:
    return transformations.transform_from_pq(theirs(pose))


def their_motion(node: Node, position: float) -> Any:
    """What a joint does, as a matrix."""
    assert node.joint is not None
    if node.joint.type is JointType.PRISMATIC:
        return transformations.transform_from(np.eye(3), np.array(node.joint.axis) * position)
    turn = rotations.matrix_from_axis_angle([*node.joint.axis, position])
    return transformations.transform_from(turn, np.zeros(3))


@pytest.mark.slow
@given(tree=trees(), time_ns=st.integers(0, 1000), data=st.data())
@FEW
def test_poses_in_a_random_tree_at_random_times_agree(
    tree: list[Node], time_ns: int, data: st.DataObject
) -> None:
    graph, oracle, share = SceneGraph(tree), TransformManager(), time_ns / 1000
    for node in tree[1:]:
        place = their_matrix(node.origin)
        if node.joint_type is JointType.FLOATING:
            first, second = data.draw(poses()), data.draw(poses())
            assume(not are_half_a_turn_apart(first, second))
            graph.move(node.name, 0, first)
            graph.move(node.name, 1000, second)
            place = slerp(first, second, share)
        elif node.joint is not None:
            begin, way = data.draw(ANGLES), data.draw(st.floats(-3.0, 3.0))
            graph.set_joint(node.joint.name, 0, begin)
            graph.set_joint(node.joint.name, 1000, begin + way)
            place = place @ their_motion(node, begin + share * way)
        oracle.add_transform(node.name, node.parent, place)
    for a in graph:
        for b in graph:
            pose = graph.pose(a.name, b.name, time_ns)
            assert_close(pose.matrix, oracle.get_transform(b.name, a.name))
            assert math.hypot(*pose[3:]) == pytest.approx(1.0, abs=1e-12)


@given(poses(), poses(), st.floats(0.0, 1.0))
@FEW
def test_interpolated_poses_agree(first: RigidTransform, second: RigidTransform, share: float) -> None:
    assume(not are_half_a_turn_apart(first, second))
    ours = RigidTransform(*interpolate(first, second, share))
    assert_close(ours.matrix, slerp(first, second, share))


@given(poses(), st.floats(1e-9, 1e-3), st.floats(0.0, 1.0))
@FEW
def test_interpolated_poses_agree_if_they_hardly_differ(
    first: RigidTransform, angle: float, share: float
) -> None:
    second = first @ RigidTransform.from_rpy((0.0, 0.0, 0.0), (angle, 0.0, 0.0))
    ours = RigidTransform(*interpolate(first, second, share))
    expected = first @ RigidTransform.from_rpy((0.0, 0.0, 0.0), (share * angle, 0.0, 0.0))
    assert_close(ours.matrix, expected.matrix)


def are_half_a_turn_apart(first: RigidTransform, second: RigidTransform) -> bool:
    """Then both ways are equally short, and either is right."""
    return abs(float(np.dot(first.quaternion, second.quaternion))) < 1e-9


def slerp(first: RigidTransform, second: RigidTransform, share: float) -> Any:
    one, other = theirs(first), theirs(second)
    turn = rotations.quaternion_slerp(one[3:], other[3:], share, shortest_path=True)
    place = (1 - share) * one[:3] + share * other[:3]
    return transformations.transform_from_pq([*place, *turn])


@given(poses(), poses(), st.lists(st.tuples(LENGTHS, LENGTHS, LENGTHS), min_size=1, max_size=4))
@FEW
def test_products_inverses_and_points_agree(a: RigidTransform, b: RigidTransform, points: list[Any]) -> None:
    assert_close((a @ b).matrix, their_matrix(a) @ their_matrix(b))
    assert_close(a.inverse().matrix, transformations.invert_transform(their_matrix(a)))
    moved = transformations.transform(their_matrix(a), transformations.vectors_to_points(points))
    assert_close(a.apply(points), moved[:, :3])


@given(st.tuples(ANGLES, ANGLES, ANGLES))
@FEW
def test_roll_pitch_and_yaw_turn_about_the_axes_of_the_parent(rpy: tuple[float, float, float]) -> None:
    expected = rotations.matrix_from_euler(np.array(rpy), 0, 1, 2, extrinsic=True)
    assert_close(RigidTransform.from_rpy((0, 0, 0), rpy).matrix[:3, :3], expected)
