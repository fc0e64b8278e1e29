"""Removed poses pass their information on to others."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.workers.mapping.graph_thinning import without
from robbie_robots.workers.mapping.pose_graph import PoseGraph
from robbie_robots.workers.mapping.redundancy import redundant
from robbie_robots.workers.planar_pose import relative, wrap_angle

RANDOM = np.random.default_rng(3)
POSES = np.column_stack([np.arange(6.0), np.sin(np.arange(6.0)), np.linspace(0, 4, 6)])
INFORMATION = np.diag([400.0, 300.0, 900.0])


def graph_of(poses: NDArray[np.float64], loops: Sequence[tuple[int, int]] = ()) -> PoseGraph:
    """A chain with exact measurements, and loops."""
    graph = PoseGraph()
    for pose in poses:
        graph.add_pose(pose)
    for base in range(len(poses) - 1):
        graph.add_edge(base, base + 1, relative(poses[base], poses[base + 1]), INFORMATION)
    for base, seen in loops:
        graph.add_edge(base, seen, relative(poses[base], poses[seen]), INFORMATION, closes_loop=True)
    graph.settled()
    return graph


def test_remaining_poses_do_not_move_and_still_fit() -> None:
    thinned, heirs = without(graph_of(POSES, loops=[(0, 4), (1, 5)]), [1, 3])
    assert np.array_equal(thinned.poses, POSES[[0, 2, 4, 5]])
    assert heirs.tolist()[::2] == [0, 2, 4] and heirs[5] == 5
    assert heirs[1] in (0, 2) and heirs[3] in (2, 4)
    state = thinned.state()
    for (base, seen), measured in zip(state["ends"], state["measured"], strict=True):
        error = relative(thinned.poses[base], thinned.poses[seen]) - measured
        assert np.abs([*error[:2], wrap_angle(error[2])]).max() < 1e-9
    assert thinned.optimise() < 1e-6
    chain = {tuple(ends) for ends in state["ends"][~state["closes_loop"]].tolist()}
    assert {tuple(sorted(ends)) for ends in chain} == {(0, 1), (1, 2), (2, 3)}


def test_thinned_graph_settles_like_the_complete_one() -> None:
    whole = graph_of(POSES, loops=[(0, 5)])
    measured = relative(POSES[0], POSES[5]) + np.array([0.1, -0.05, 0.03])
    thinned, _ = without(whole, [2, 3])
    for graph, last in ((whole, 5), (thinned, 3)):
        graph.add_edge(0, last, measured, INFORMATION, closes_loop=True)
        graph.optimise()
    assert thinned.poses == pytest.approx(whole.poses[[0, 1, 4, 5]], abs=0.01)
    assert np.abs(whole.poses[5] - POSES[5]).max() > 0.02


def test_uncertainties_along_a_path_add_up() -> None:
    straight = np.column_stack([np.arange(4.0), np.zeros(4), np.zeros(4)])
    thinned, _ = without(graph_of(straight), [1, 2])
    covariance = np.linalg.inv(thinned.state()["information"][0])
    assert covariance[0, 0] == pytest.approx(3 / 400, rel=1e-3)
    assert covariance[2, 2] == pytest.approx(3 / 900, rel=1e-3)
    assert covariance[1, 1] > 3 / 300


def test_chain_of_heirs_ends_at_a_remaining_pose() -> None:
    _, heirs = without(graph_of(POSES), [1, 2, 3, 4])
    assert set(heirs.tolist()) <= {0, 5}


def test_edge_of_a_false_loop_is_not_passed_on() -> None:
    graph = graph_of(POSES)
    graph.add_edge(2, 5, (9.0, 9.0, 0.0), INFORMATION, closes_loop=True)
    graph.settled()
    thinned, _ = without(graph, [2])
    assert not thinned.state()["closes_loop"].any()


def test_number_of_edges_shrinks_with_the_poses() -> None:
    count = 60
    poses = np.column_stack([RANDOM.random((count, 2)), np.zeros(count)])
    loops = [(base, seen) for base in range(count) for seen in range(base + 2, count, 3)]
    thinned, _ = without(graph_of(poses, loops), list(range(1, 40)))
    assert len(thinned.state()["ends"]) <= 3 * len(thinned.poses)


def test_newer_sweeps_of_a_place_are_redundant_except_the_most_recent() -> None:
    lap = np.column_stack([np.arange(0, 40, 2.0), np.zeros(20), np.zeros(20)])
    again = lap + np.array([0.05, 0.05, 0.02])
    poses = np.concatenate([lap, again])
    travelled = np.concatenate([np.arange(0, 40, 2.0), 40 + np.arange(0, 40, 2.0)])
    # The second lap, without its last 15 m.
    assert redundant(poses, travelled, 12) == list(range(20, 32))
    more = redundant(poses, travelled, 25)
    assert 0 not in more and max(travelled[more]) < travelled[-1] - 15.0


def test_redundant_sweeps_are_at_most_as_many_as_old_ones() -> None:
    poses = np.column_stack([np.linspace(0, 20, 41), np.zeros((41, 2))])
    assert len(redundant(poses, poses[:, 0], 100)) <= 10
    assert redundant(poses[:3], poses[:3, 0], 1) == []
