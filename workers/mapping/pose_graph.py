"""Pose graph: poses joined by measured relative poses, and the poses that fit all measurements best.

Lu and Milios, "Globally consistent range scan alignment for environment mapping" (Autonomous Robots, 1997).
The solver is Gauss-Newton over sparse matrices, as in Grisetti, Kümmerle, Stachniss and Burgard, "A tutorial
on graph-based SLAM" (2010). The worse an edge that closes a loop fits, the less it counts (Agarwal et al.,
"Robust map optimization using dynamic covariance scaling", ICRA 2013), so one false match cannot bend the
map. That doubt grows while solving (Yang et al., "Graduated non-convexity for robust spatial perception",
RA-L 2020).
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu

from robbie_robots.workers.planar_pose import relative, wrap_angle
from robbie_robots.workers.row_log import RowLog

DOUBT = 10.0  # an edge's squared error (in its own standard deviations) beyond which it counts less
CONTRADICTED = 400.0  # the same, beyond which a loop is removed
DOUBT_GROWTH = 4.0  # from round to round, until DOUBT is reached
MOST_ROUNDS = 20
SETTLED_M = 1e-3
MIN_INFORMATION = 1e-6
LOOSE_M = 0.3  # an edge whose position has this standard deviation or more is loose
DISTANCE_PER_DEVIATION = 50.0  # m of way that are as uncertain as 1 m of a loose edge's deviation


class PoseGraph:
    """Poses `(N, 3)` and the edges between them; the first pose stays where it is."""

    def __init__(self) -> None:
        self.poses = np.zeros((0, 3))
        # Each row: base, seen, measured (3), information (9), whether it closes a loop.
        self._log = RowLog(15, sys.maxsize)
        self._settled_edges = 0  # number of edges at the last optimisation

    def add_pose(self, pose: ArrayLike) -> int:
        """Add a pose and return its number."""
        self.poses = np.vstack([self.poses, np.asarray(pose, float)])
        return len(self.poses) - 1

    def add_edge(
        self, base: int, seen: int, measured: ArrayLike, information: ArrayLike, closes_loop: bool = False
    ) -> None:
        """Join two poses: `seen` was measured from `base`, with inverse covariance `information` `(3, 3)`."""
        self._log.add([base, seen, *np.ravel(measured), *np.ravel(information), closes_loop])

    def settled(self) -> None:
        """Mark the poses as those that fit the edges best, as after `optimise`."""
        self._settled_edges = len(self._log)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the whole state as arrays. `optimise` may change them."""
        edges = self._edges()
        return {
            "poses": self.poses,
            "ends": edges.ends,
            "measured": edges.measured,
            "information": edges.information,
            "closes_loop": edges.doubtful,
            "settled_edges": np.array(self._settled_edges),
        }

    @staticmethod
    def from_state(state: Mapping[str, NDArray[Any]]) -> "PoseGraph":
        """Make the graph that `state` was taken from."""
        graph = PoseGraph()
        graph.poses = np.array(state["poses"])
        edges = (state[name] for name in ("ends", "measured", "information", "closes_loop"))
        for ends, measured, information, closes_loop in zip(*edges, strict=True):
            graph.add_edge(int(ends[0]), int(ends[1]), measured, information, bool(closes_loop))
        graph._settled_edges = int(state["settled_edges"])
        return graph

    def distances_m(self, start: int, limit_m: float = np.inf) -> NDArray[np.float64]:
        """Return each pose's distance from `start` along edges, m: uncertainty grows with it.

        A loose edge, as after a slip or a gap, counts as a long way.
        """
        edges = self._edges()
        ends, lengths = edges.ends, np.hypot(*edges.measured[:, :2].T) + 1e-6
        deviation_m = edges.deviations_m()
        loose_m = np.where(deviation_m < LOOSE_M, 0.0, DISTANCE_PER_DEVIATION * deviation_m)
        lengths = np.maximum(lengths, loose_m)
        shape = (len(self.poses), len(self.poses))
        graph = csr_matrix((lengths, (ends[:, 0], ends[:, 1])), shape=shape)
        distances: NDArray[np.float64] = dijkstra(graph, directed=False, indices=[start], limit=limit_m)[0]
        return distances

    def optimise(self) -> float:
        """Move the poses so that they fit the edges best.

        Returns:
            The largest distance that any pose moved, m.
        """
        if not len(self._log):
            return 0.0
        before = self.poses.copy()
        edges = self._edges()
        # A new edge starts with little doubt: after a long loop it is far from fitting at first.
        new = edges.doubtful & (np.arange(len(self._log)) >= self._settled_edges)
        doubt = max(DOUBT, float(edges.squared_errors(self.poses)[new].max(initial=0.0)))
        for _ in range(MOST_ROUNDS):
            step = self._step(edges, doubt)
            self.poses[1:] += step
            self.poses[:, 2] = wrap_angle(self.poses[:, 2])
            if doubt == DOUBT and np.abs(step).max() < SETTLED_M:
                break
            doubt = max(DOUBT, doubt / DOUBT_GROWTH)
        self.settled()
        return float(np.hypot(*(self.poses - before)[:, :2].T).max())

    def covariance_between(self, base: int, seen: int) -> NDArray[np.float64]:
        """Return how well a pose is known from another one: covariance `(3, 3)`, in the frame of `base`."""
        if base == seen:
            return np.zeros((3, 3))
        edges = self._edges()
        factors = self._factors(edges, *self._weighted(edges, DOUBT))
        derivatives = jacobians(self.poses[[base]], self.poses[[seen]])[0]
        by_poses = np.zeros((3 * len(self.poses), 3))
        by_poses[3 * base : 3 * base + 3] = derivatives[0].T
        by_poses[3 * seen : 3 * seen + 3] += derivatives[1].T
        covariance: NDArray[np.float64] = by_poses[3:].T @ factors.solve(by_poses[3:])
        return covariance

    def parts(self) -> NDArray[np.int64]:
        """Return for each pose `(N,)` its part of the map: only loose edges join one part to another."""
        edges = self._edges()
        fits = ~edges.doubtful | (edges.squared_errors(self.poses) < DOUBT)
        firm = edges.ends[fits & (edges.deviations_m() < LOOSE_M)]
        shape = (len(self.poses), len(self.poses))
        joined = csr_matrix((np.ones(len(firm)), (firm[:, 0], firm[:, 1])), shape=shape)
        return connected_components(joined, directed=False)[1].astype(np.int64)

    def drop_contradicted(self) -> int:
        """Remove the loops that the other edges contradict. Return how many."""
        edges = self._edges()
        kept = ~(edges.doubtful & (edges.squared_errors(self.poses) > CONTRADICTED))
        if not kept.all():
            self._log.restore({"rows": self._log.rows[kept], "forgotten": 0})
            self.settled()
        return int((~kept).sum())

    def _edges(self) -> "_Edges":
        rows = self._log.rows
        return _Edges(
            rows[:, :2].astype(np.int64),
            rows[:, 2:5].copy(),
            rows[:, 5:14].reshape(-1, 3, 3).copy(),
            rows[:, 14] > 0,
        )

    def _step(self, edges: "_Edges", doubt: float) -> NDArray[np.float64]:
        """Return one Gauss-Newton step for all poses except the first, `(N - 1, 3)`."""
        weighted, derivatives = self._weighted(edges, doubt)
        rights = -np.einsum("eaij,ej->eai", weighted, edges.errors(self.poses))
        variables = edges.ends[:, :, None] * 3 + np.arange(3)
        right = np.bincount(variables.ravel(), rights.ravel(), minlength=3 * len(self.poses))
        factors = self._factors(edges, weighted, derivatives)
        return np.asarray(factors.solve(right[3:])).reshape(-1, 3)

    def _weighted(self, edges: "_Edges", doubt: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the edges' derivatives times their information, `(E, 2, 3, 3)`, and the derivatives."""
        trust = np.minimum(1.0, 2 * doubt / (doubt + edges.squared_errors(self.poses))) ** 2
        trust = np.where(edges.doubtful, trust, 1.0)
        derivatives = jacobians(self.poses[edges.ends[:, 0]], self.poses[edges.ends[:, 1]])
        return np.einsum("eaji,ejk->eaik", derivatives, edges.information * trust[:, None, None]), derivatives

    def _factors(
        self, edges: "_Edges", weighted: NDArray[np.float64], derivatives: NDArray[np.float64]
    ) -> Any:
        """Factorise the Hessian of all poses except the first."""
        blocks = np.einsum("eaij,ebjk->eabik", weighted, derivatives)
        variables = edges.ends[:, :, None] * 3 + np.arange(3)
        rows = np.broadcast_to(variables[:, :, None, :, None], blocks.shape)
        columns = np.broadcast_to(variables[:, None, :, None, :], blocks.shape)
        size = 3 * len(self.poses)
        system = coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)).tocsc()
        return splu(system[3:, 3:], permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})


@dataclass(frozen=True)
class _Edges:
    """All edges as arrays: ends `(E, 2)`, measured `(E, 3)`, information `(E, 3, 3)`, doubtful `(E,)`."""

    ends: NDArray[np.int64]
    measured: NDArray[np.float64]
    information: NDArray[np.float64]
    doubtful: NDArray[np.bool_]

    def errors(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        error = relative(poses[self.ends[:, 0]], poses[self.ends[:, 1]]) - self.measured
        error[:, 2] = wrap_angle(error[:, 2])
        return error

    def deviations_m(self) -> NDArray[np.float64]:
        """Return the greater standard deviation of each edge, along or across, m."""
        weakest = np.minimum(self.information[:, 0, 0], self.information[:, 1, 1])
        deviations: NDArray[np.float64] = np.maximum(weakest, MIN_INFORMATION) ** -0.5
        return deviations

    def squared_errors(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Each edge's squared error, in its own standard deviations."""
        error = self.errors(poses)
        return np.asarray(np.einsum("ei,eij,ej->e", error, self.information, error))


def jacobians(base: NDArray[np.float64], seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Derivatives of `relative(base, seen)` by both, `(E, 2, 3, 3)`."""
    cos, sin = np.cos(base[:, 2]), np.sin(base[:, 2])
    dx, dy = seen[:, 0] - base[:, 0], seen[:, 1] - base[:, 1]
    result = np.zeros((len(base), 2, 3, 3))
    result[:, 1, 0, 0], result[:, 1, 0, 1] = cos, sin
    result[:, 1, 1, 0], result[:, 1, 1, 1] = -sin, cos
    result[:, 1, 2, 2] = 1
    result[:, 0] = -result[:, 1]
    result[:, 0, 0, 2] = -sin * dx + cos * dy
    result[:, 0, 1, 2] = -cos * dx - sin * dy
    return result
