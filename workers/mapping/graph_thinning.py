"""Remove poses from a pose graph, and pass their edges to their neighbours.

In outline Kretzschmar and Stachniss, "Information-theoretic compression of pose graphs for laser-based SLAM"
(IJRR 2012): a removed pose passes its edges to one neighbour, its heir, and the uncertainties add up. The
graph stays sparse. The result may be too pessimistic, never too confident: no measurement counts twice
between the same two poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.mapping.pose_graph import DOUBT, PoseGraph, jacobians
from robbie_robots.workers.planar_pose import relative

LOOPS_PER_POSE = 2  # loop edges kept, on average; the least informative are removed first
SINGULAR = 1e-6
HERE = np.zeros(3)

Array = NDArray[np.float64]
Pair = tuple[int, int, bool]


@dataclass(frozen=True)
class _Edge:
    """Pose `seen` as measured from `base`, with its inverse covariance in the frame of `base`."""

    base: int
    seen: int
    measured: Array
    information: Array
    closes_loop: bool

    @property
    def pair(self) -> Pair:
        return min(self.base, self.seen), max(self.base, self.seen), self.closes_loop

    @property
    def weight(self) -> float:
        return float(np.linalg.det(self.information))

    def seen_from(self, pose: int) -> "_Edge":
        """Return the edge with `pose`, one of its ends, as the base."""
        if pose == self.base:
            return self
        turn = jacobians(self.measured[None], HERE[None])[0, 0]
        information = np.linalg.inv(turn @ self.covariance @ turn.T)
        return _Edge(pose, self.base, relative(self.measured, HERE), information, self.closes_loop)

    @property
    def covariance(self) -> Array:
        covariance: Array = np.linalg.inv(self.information + SINGULAR * np.eye(3)).astype(
            np.float64, copy=False
        )
        return covariance


def without(graph: PoseGraph, removed: Sequence[int]) -> tuple[PoseGraph, NDArray[np.int64]]:
    """Return a settled graph without some of its poses. The others keep their order and do not move.

    Args:
        graph: The graph; it does not change.
        removed: Numbers of the poses to remove; never the first one.

    Returns:
        The new graph; and for each pose of the old graph `(N,)` the old number of the pose that now
        represents it: itself, or its heir.
    """
    edges, at = _read(graph)
    heir = np.arange(len(graph.poses))
    for pose in removed:
        spokes = [edges[pair].seen_from(pose) for pair in sorted(at[pose])]
        for pair in at.pop(pose):
            at[pair[0] if pair[1] == pose else pair[1]].discard(pair)
            del edges[pair]
        hub = min(spokes, key=lambda spoke: (spoke.closes_loop, float(np.hypot(*spoke.measured[:2]))))
        heir[pose] = hub.seen
        for spoke in spokes:
            if spoke.seen != hub.seen and not _is_doubtful(graph, spoke):
                _keep(edges, at, _joined(hub, spoke))
    for pose in reversed(removed):
        heir[pose] = heir[heir[pose]]
    return _written(graph, edges, set(removed)), heir


def _read(graph: PoseGraph) -> tuple[dict[Pair, _Edge], dict[int, set[Pair]]]:
    """Return the edges by their pair of poses, and the pairs that contain each pose."""
    state = graph.state()
    edges: dict[Pair, _Edge] = {}
    at: dict[int, set[Pair]] = {number: set() for number in range(len(graph.poses))}
    rows = zip(state["ends"], state["measured"], state["information"], state["closes_loop"], strict=True)
    for (base, seen), measured, information, closes_loop in rows:
        _keep(edges, at, _Edge(int(base), int(seen), measured, information, bool(closes_loop)))
    return edges, at


def _keep(edges: dict[Pair, _Edge], at: dict[int, set[Pair]], edge: _Edge) -> None:
    """Add an edge, unless a better one already joins the same two poses."""
    there = edges.get(edge.pair)
    if there is None or there.weight < edge.weight:
        edges[edge.pair] = edge
        at[edge.base].add(edge.pair)
        at[edge.seen].add(edge.pair)


def _joined(hub: _Edge, spoke: _Edge) -> _Edge:
    """Return the edge from the end of one edge to the end of the other. Both have the same base."""
    by_hub, by_spoke = jacobians(hub.measured[None], spoke.measured[None])[0]
    covariance = by_hub @ hub.covariance @ by_hub.T + by_spoke @ spoke.covariance @ by_spoke.T
    measured = relative(hub.measured, spoke.measured)
    closes_loop = hub.closes_loop or spoke.closes_loop
    return _Edge(hub.seen, spoke.seen, measured, np.linalg.inv(covariance), closes_loop)


def _is_doubtful(graph: PoseGraph, edge: _Edge) -> bool:
    """Return whether an edge that closes a loop fits so badly that it hardly counts."""
    if not edge.closes_loop:
        return False
    error = relative(edge.measured, relative(graph.poses[edge.base], graph.poses[edge.seen]))
    return float(error @ edge.information @ error) > DOUBT


def _written(graph: PoseGraph, edges: dict[Pair, _Edge], removed: set[int]) -> PoseGraph:
    """Make a graph of the remaining poses and edges, with new pose numbers."""
    kept = [number for number in range(len(graph.poses)) if number not in removed]
    number = {old: new for new, old in enumerate(kept)}
    loops = sorted((edge for edge in edges.values() if edge.closes_loop), key=lambda edge: -edge.weight)
    chain = [edge for edge in edges.values() if not edge.closes_loop]
    thinned = PoseGraph()
    thinned.poses = graph.poses[kept].copy()
    kept_edges = chain + loops[: LOOPS_PER_POSE * len(kept)]
    for edge in sorted(kept_edges, key=lambda edge: (edge.pair[1], edge.pair)):
        thinned.add_edge(
            number[edge.base], number[edge.seen], edge.measured, edge.information, edge.closes_loop
        )
    thinned.settled()
    return thinned
