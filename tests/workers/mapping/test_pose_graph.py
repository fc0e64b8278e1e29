"""A pose graph closes loops, and a false loop does not bend it."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.workers.mapping.pose_graph import PoseGraph
from robbie_robots.workers.planar_pose import compose, relative

CERTAIN = np.diag([1e4, 1e4, 1e5])


def square(steps_per_side: int = 10) -> NDArray[np.float64]:
    """Poses round a square of 10 m, beginning and ending in one place."""
    step, poses = [10 / steps_per_side, 0, 0], [np.zeros(3)]
    for number in range(4 * steps_per_side):
        turn = np.pi / 2 if (number + 1) % steps_per_side == 0 else 0
        poses.append(compose(poses[-1], [step[0], 0, turn]))
    return np.array(poses)


def drifting(true: NDArray[np.float64], turn_rad: float = 0.01) -> PoseGraph:
    graph = PoseGraph()
    graph.add_pose(true[0])
    for number, measured in enumerate(relative(true[:-1], true[1:])):
        wrong = measured + np.array([0.01, 0, turn_rad])
        graph.add_pose(compose(graph.poses[-1], wrong))
        graph.add_edge(number, number + 1, wrong, CERTAIN)
    return graph


def farthest_off(graph: PoseGraph, true: NDArray[np.float64]) -> float:
    return float(np.hypot(*(graph.poses - true)[:, :2].T).max())


def test_closed_loop_removes_the_drift() -> None:
    true = square()
    graph = drifting(true)
    before = farthest_off(graph, true)
    graph.add_edge(0, len(true) - 1, relative(true[0], true[-1]), CERTAIN, closes_loop=True)
    moved = graph.optimise()
    assert before > 2.0
    assert farthest_off(graph, true) < 0.5 * before
    assert np.hypot(*(graph.poses[-1] - true[-1])[:2]) < 0.1
    assert moved > 1.0


def test_consistent_edges_are_satisfied_exactly() -> None:
    true = square()
    graph = drifting(true)
    graph.poses[5:, :2] += 0.3
    graph.optimise()
    measured = relative(true[:-1], true[1:]) + np.array([0.01, 0, 0.01])
    assert relative(graph.poses[:-1], graph.poses[1:]) == pytest.approx(measured, abs=1e-6)


def two_laps(false_edges: Sequence[tuple[int, int, list[float]]] = ()) -> NDArray[np.float64]:
    lap = square()
    graph = drifting(np.concatenate([lap, lap[1:]]))
    for old in range(0, 40, 5):
        graph.add_edge(old, old + 40, [0, 0, 0], CERTAIN, closes_loop=True)
    for old, new, measured in false_edges:
        graph.add_edge(old, new, measured, CERTAIN, closes_loop=True)
    graph.optimise()
    return graph.poses


def test_false_loop_among_true_ones_does_not_bend_the_map() -> None:
    honest, misled = two_laps(), two_laps([(5, 25, [0.5, 0.0, 1.0])])
    assert np.hypot(*(honest - misled)[:, :2].T).max() < 0.1


def test_false_loop_found_later_does_not_bend_the_map() -> None:
    lap = square()
    graph = drifting(lap)
    for old in range(5):
        graph.add_edge(old, 40 - old, relative(lap[old], lap[40 - old]), CERTAIN, closes_loop=True)
    graph.optimise()
    honest = graph.poses.copy()
    graph.add_edge(5, 25, [0.5, 0.0, 1.0], CERTAIN, closes_loop=True)
    graph.optimise()
    graph.optimise()
    assert np.hypot(*(honest - graph.poses)[:, :2].T).max() < 0.1


def test_graph_without_edges_does_not_move() -> None:
    graph = PoseGraph()
    graph.add_pose([1, 2, 3])
    assert graph.optimise() == 0.0
    assert graph.poses.tolist() == [[1, 2, 3]]


def test_distances_follow_the_shortest_path_along_edges() -> None:
    true = square()
    graph = drifting(true)
    assert graph.distances_m(0)[-1] == pytest.approx(40.4, abs=0.01)
    graph.add_edge(0, len(true) - 1, [0, 0, 0], CERTAIN, closes_loop=True)
    assert graph.distances_m(0)[-2] == pytest.approx(1.01, abs=0.01)


def test_graph_restored_from_its_state_continues_identically() -> None:
    graph = drifting(square())
    graph.add_edge(0, 40, [0, 0, 0], CERTAIN, closes_loop=True)
    copy = PoseGraph.from_state(graph.state())
    graph.optimise()
    copy.optimise()
    assert np.array_equal(graph.poses, copy.poses)


def test_part_that_only_a_loose_edge_joins_is_a_part_until_a_loop_joins_it() -> None:
    graph, firm, loose = PoseGraph(), np.diag([1e4, 1e4, 1e5]), np.diag([1.0, 1.0, 10.0])
    for number in range(6):
        graph.add_pose((float(number), 0.0, 0.0))
        if number:
            graph.add_edge(number - 1, number, (1, 0, 0), loose if number == 3 else firm)
    assert graph.parts().tolist() == [0, 0, 0, 1, 1, 1]
    graph.add_edge(1, 5, (4.0, 3.0, 0), firm, closes_loop=True)
    assert graph.parts().max() == 1, "a loop that does not fit joins nothing"
    graph.add_edge(1, 5, (4, 0, 0), firm, closes_loop=True)
    assert graph.parts().max() == 0
