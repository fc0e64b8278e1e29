"""Fine scan matching: bring a sweep's points onto the surfaces of reference points.

The method is iterative closest point. A point may slide along a flat surface but not off it: this is the
point-to-line distance of Censi ("An ICP variant using a point-to-line metric", ICRA 2008). Where the
reference is clutter, the distance counts in all directions. Both are cases of Segal, Haehnel and Thrun,
"Generalized-ICP" (RSS 2009). A Cauchy weight limits the pull of objects that have moved. Odometry can serve
as a prior.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from robbie_robots.workers.laser.surface_points import SurfacePoints
from robbie_robots.workers.planar_pose import rotate, rotated_information, wrap_angle

SURFACE_NOISE_M = 0.03
CLUTTER_NOISE_M = 0.06
SAME_SIDE = 0.5  # least cosine between the normals of points that may lie on one surface
ON_SURFACE = 9.0  # squared distance, in standard deviations, within which a point lies on a surface
COARSE_DISTANCE_M, FINE_DISTANCE_M = 0.3, 0.15  # to a point's partner, in the first and the last iteration
NARROWING = 0.7
MOST_ROUNDS = 20
SETTLED = 1e-3  # m and rad alike
MATCH_TRUST = 0.2  # the errors of one sweep's points are correlated, so they count as fewer points
REALLY_KNOWN = 0.33  # share of a match's information with which it leaves its prior: points change partners
NORMAL_NOISE = 0.06  # rad; along a bare wall, this noise of its normals looks like knowledge
STEADY = 1e-3 * np.eye(3)  # keeps a sweep without partners at its guess


@dataclass(frozen=True)
class Match:
    """The pose at which a sweep fits.

    Attributes:
        pose: x (m), y (m), heading (rad) in the reference's frame.
        information: `(3, 3)`, inverse covariance of the pose by the sweep alone, in the reference's frame.
        on_surface: `(N,) bool`, which of the sweep's points lie on a surface of the reference.
        known: `(3,)`, along, across, heading in the robot's frame: the share of what is known that comes from
            the sweep; the rest comes from odometry.
    """

    pose: NDArray[np.float64]
    information: NDArray[np.float64]
    on_surface: NDArray[np.bool_]
    known: NDArray[np.float64] = field(default_factory=lambda: np.ones(3))

    def fused(self, guess: NDArray[np.float64], deviation: NDArray[np.float64]) -> "Match":
        """Let odometry decide what a match by the sweep alone leaves open.

        Args:
            guess: The pose by odometry, in the reference's frame.
            deviation: Odometry's standard deviation along, across (m), and in heading (rad).
        """
        prior = rotated_information(np.diag(deviation**-2.0), guess[2])
        off = guess - self.pose
        off[2] = wrap_angle(off[2])
        pose = self.pose + np.linalg.solve(self.information + prior, prior @ off)
        pose[2] = wrap_angle(pose[2])
        return replace(self, pose=pose).informed(prior)

    def informed(self, prior: NDArray[np.float64]) -> "Match":
        """Return the match with the information of odometry, in the reference's frame, besides its own."""
        alone, together = (
            np.diag(np.linalg.inv(rotated_information(one, -self.pose[2])))
            for one in (prior, prior + REALLY_KNOWN * self.information)
        )
        return replace(self, information=self.information + prior, known=1 - together / alone)


class ScanMatcher:
    """Matches sweeps against one set of reference points.

    Args:
        reference: The points.
        trust: How much each point of a sweep counts, up to 1.
    """

    def __init__(self, reference: SurfacePoints, trust: float = MATCH_TRUST) -> None:
        self._trust = trust
        self._points, self._normals = reference.points, reference.normals
        self._tree = cKDTree(reference.points)
        across = np.einsum("ni,nj->nij", reference.normals, reference.normals) / SURFACE_NOISE_M**2
        flat = np.asarray(reference.normals.any(axis=1))
        self._stiffness = np.where(flat[:, None, None], across, np.eye(2) / CLUTTER_NOISE_M**2)

    def refine(
        self,
        sweep: SurfacePoints,
        guess: ArrayLike,
        prior: ArrayLike | None = None,
        prior_information: NDArray[np.float64] | None = None,
    ) -> Match:
        """Match a sweep, starting near the right pose, by Gauss-Newton.

        Args:
            sweep: Points in the frame of the pose sought.
            guess: The pose to start from, in the reference's frame.
            prior: The pose by odometry, if it is to count.
            prior_information: `(3, 3)` inverse covariance of the prior.
        """
        pose = np.array(guess, float)
        distance_m = COARSE_DISTANCE_M
        for _ in range(MOST_ROUNDS):
            information, feigned, pull, on_surface = self._linearised(sweep, pose, distance_m)
            hessian = information + STEADY
            if prior is not None and prior_information is not None:
                # What only noise of the normals seems to know must not pull against the prior.
                known = _at_least_zero(information - feigned)
                pull = known @ np.linalg.solve(hessian, pull)
                off = np.asarray(prior, float) - pose
                off[2] = wrap_angle(off[2])
                hessian, pull = known + STEADY + prior_information, pull + prior_information @ off
            step = np.linalg.solve(hessian, pull)
            pose = pose + step
            if distance_m <= FINE_DISTANCE_M and np.abs(step).max() < SETTLED:
                break
            distance_m = max(FINE_DISTANCE_M, NARROWING * distance_m)
        pose[2] = wrap_angle(pose[2])
        return Match(pose, _at_least_zero(information - feigned), on_surface)

    def fit(self, sweep: SurfacePoints, pose: NDArray[np.float64]) -> Match:
        """Return how a sweep fits at a pose, without moving it."""
        information, feigned, _, on_surface = self._linearised(sweep, pose, FINE_DISTANCE_M)
        return Match(pose, _at_least_zero(information - feigned), on_surface)

    def cost(
        self,
        sweep: SurfacePoints,
        match: Match,
        near_m: float,
        prior: NDArray[np.float64],
        prior_information: NDArray[np.float64],
    ) -> float:
        """Return how much speaks against a match: half of a squared error in standard deviations.

        Points that lie off the surfaces near them speak against it, and so does the prior. Points that are
        farther than `near_m` from any surface may show what is new.
        """
        points = rotate(match.pose[2], sweep.points) + match.pose[:2]
        apart, _ = self._tree.query(points, distance_upper_bound=near_m)
        off_surface = int((np.isfinite(apart) & ~match.on_surface).sum())
        off = match.pose - prior
        off[2] = wrap_angle(off[2])
        return float(self._trust * ON_SURFACE * off_surface + off @ prior_information @ off) / 2

    def _linearised(
        self, sweep: SurfacePoints, pose: NDArray[np.float64], distance_m: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return Hessian, what noise of the normals adds to it, negative gradient; the points with partners.

        The Hessian and the gradient are those of weighted squared distances.
        """
        arms, facing = rotate(pose[2], sweep.points), rotate(pose[2], sweep.normals)
        points = arms + pose[:2]
        apart, nearest = self._tree.query(points, distance_upper_bound=distance_m)
        found: NDArray[np.bool_] = np.asarray(np.isfinite(apart))
        nearest = np.where(found, nearest, 0)
        off, normals = self._points[nearest] - points, self._normals[nearest]
        clutter = ~(normals.any(axis=1) & facing.any(axis=1))
        partners = found & (clutter | (np.einsum("ni,ni->n", normals, facing) > SAME_SIDE))
        stiffness = self._stiffness[nearest]
        squared = np.einsum("ni,nij,nj->n", off, stiffness, off)
        weight = self._trust * partners / (1 + squared)
        stiffness = stiffness * weight[:, None, None]
        # A point's derivative by the pose: the identity by x and y, across its arm by the heading.
        moves = np.zeros((len(points), 2, 3))
        moves[:, 0, 0] = moves[:, 1, 1] = 1
        moves[:, 0, 2], moves[:, 1, 2] = -arms[:, 1], arms[:, 0]
        stiff_moves = stiffness @ moves
        hessian = np.einsum("nia,nib->ab", moves, stiff_moves)
        pull = np.einsum("nia,ni->a", stiff_moves, off)
        moves *= (NORMAL_NOISE / SURFACE_NOISE_M * np.sqrt(weight * ~clutter))[:, None, None]
        feigned = np.einsum("nia,nib->ab", moves, moves)
        return hessian, feigned, pull, partners & (squared < ON_SURFACE)


def _at_least_zero(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the nearest positive semidefinite information `(3, 3)`."""
    # Metres and radians differ, so look at each axis in units of its own.
    unit = 1 / np.sqrt(np.maximum(np.diag(information), 1e-6))
    values, vectors = np.linalg.eigh(information * unit * unit[:, None])
    positive: NDArray[np.float64] = (vectors * np.maximum(values, 0.0)) @ vectors.T / unit / unit[:, None]
    return positive
