"""Monte Carlo localisation: where a robot is on a given map, from odometry and a planar laser.

Dellaert, Fox, Burgard and Thrun, "Monte Carlo localization for mobile robots" (ICRA 1999), with as many
particles as are needed (KLD-sampling, see `particle_cloud`). When sweeps stop fitting, particles are added
where the newest sweep would fit: their share after Gutmann and Fox, "An experimental comparison of
localization methods continued" (IROS 2002), their places after Lenser and Veloso, "Sensor resetting
localization for poorly modelled mobile robots" (ICRA 2000).
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.localization.convergence_watch import ConvergenceWatch
from robbie_robots.workers.localization.likelihood_field import LikelihoodField
from robbie_robots.workers.localization.particle_cloud import MotionNoise, ParticleCloud
from robbie_robots.workers.odometry_track import OdometryTrack
from robbie_robots.workers.planar_pose import compose, relative, transform_points

TRACKED = 2_000  # odometry entries kept to find a sweep's place among them
MOST_WAITING = 5
FEWEST_RETURNS = 10
TRACED_BEAMS = 30
CANDIDATE_BEAMS = 30  # enough beams to decide which places deserve a particle
GENTLE = 0.3  # candidates are coarse, so even the right ones fit only roughly
JITTER = (0.1, 0.1, 0.05)  # m, m, rad: what is between two candidates
AGREES_M = 0.25  # a return this near to an obstacle of the map agrees with it
SLOW, FAST = 0.02, 0.3  # rates of the moving averages of the fit
# While the pose is certain, added particles together get no more weight than this. Where the map is
# incomplete, a single sweep often fits somewhere else a little better.
DOUBT = 0.1
BEARABLE = 0.8  # other places are tried below this share of the usual fit


@dataclass(frozen=True)
class LocalizationSettings:
    """Settings of the localisation.

    Attributes:
        min_particles: Minimum number after convergence.
        min_searching: Minimum number before it; with fewer, one of several similar places would soon win.
        max_particles: Maximum number.
        candidates: Poses tried when the robot may be anywhere; for large maps more are better.
        beams: Number of beams used of each sweep, evenly spaced.
        independent_beams: Effective number of independent beams: neighbouring beams see the same wall.
        update_m: A sweep is used when the robot has moved this far since the last one used ...
        update_rad: ... or turned this far.
        expected_fit: Other places are tried when sweeps fit worse than this (0 to 1).
    """

    min_particles: int = 300
    min_searching: int = 2_000
    max_particles: int = 5_000
    candidates: int = 200_000
    beams: int = 60
    independent_beams: float = 15.0
    update_m: float = 0.1
    update_rad: float = 0.1
    expected_fit: float = 0.6


@dataclass(frozen=True)
class Localization:
    """The estimate after a sweep.

    Attributes:
        stamp_s: Stamp of the sweep.
        pose: Most likely pose of the robot (x m, y m, heading rad), map frame.
        converged: Whether the estimate has converged.
        spread_m: Standard deviation of all particles' positions.
        spread_rad: Standard deviation of their headings.
        agreement: Share of the sweep's returns that lie on the map's obstacles.
        particles: Number of particles.
    """

    stamp_s: float
    pose: NDArray[np.float64]
    converged: bool
    spread_m: float
    spread_rad: float
    agreement: float
    particles: int


@dataclass(frozen=True)
class _Beams:
    """The beams used of a sweep, in the robot's frame, m.

    Attributes:
        stamp_s: Stamp of the sweep.
        ends: `(B, 2)`, ends of beams that hit an obstacle.
        seen: `(T, 2)`, ends of the free part of some of all beams.
    """

    stamp_s: float
    ends: NDArray[np.float64]
    seen: NDArray[np.float64]


class Localizer:
    """Finds and tracks a robot on a map; starts without a pose unless you give one.

    Args:
        field: The map.
        settings: Settings of the localisation.
        laser_pose: The laser's mounting pose on the robot (x m, y m, heading rad).
        seed: Random seed; the same inputs and seed give the same poses.

    Attributes:
        newest: The estimate after the last sweep used; None before the first.
        recoveries: How often particles were added because sweeps did not fit.
        unplaced: How many sweeps were left out because odometry does not know their stamps.
        unplaced_in_a_row: Likewise, since the last one that it knew.
    """

    def __init__(
        self,
        field: LikelihoodField,
        settings: LocalizationSettings | None = None,
        laser_pose: ArrayLike = (0.0, 0.0, 0.0),
        seed: int = 0,
    ) -> None:
        self.field = field
        self.settings = settings or LocalizationSettings()
        self.laser_pose = np.asarray(laser_pose, float)
        self.newest: Localization | None = None
        self.recoveries = self.unplaced = self.unplaced_in_a_row = 0
        self._noise = MotionNoise()
        self._random = np.random.default_rng(seed)
        self._odometry = OdometryTrack(TRACKED)
        self._waiting: deque[_Beams] = deque(maxlen=MOST_WAITING)
        self._cloud: ParticleCloud | None = None
        self._at: NDArray[np.float64] | None = None  # odometry's pose at the last sweep that counted
        self._expected: NDArray[np.float64] | None = None
        self._convergence = ConvergenceWatch()
        self._travelled_m = 0.0
        self._slow = self._fast = 1.0

    def start_at(self, pose: ArrayLike, spread_m: float = 0.3, spread_rad: float = 0.2) -> None:
        """Restart near a known pose (x m, y m, heading rad), map frame."""
        spread = np.array([spread_m, spread_m, spread_rad])
        count = self.settings.max_particles
        self._cloud = ParticleCloud(np.asarray(pose, float) + self._random.normal(size=(count, 3)) * spread)
        self._forget()

    def start_anywhere(self) -> None:
        """Restart globally: the next sweep decides where the robot may be."""
        self._cloud = None
        self._forget()

    def add_odometry(self, stamp_s: float, pose: ArrayLike) -> None:
        """Add an odometry pose (x m, y m, heading rad; odometry frame)."""
        self._odometry.add(stamp_s, pose)
        self._use_waiting()

    def add_scan(self, stamp_s: float, sweep: LaserSweep) -> None:
        """Add a sweep.

        It is used once odometry has reached its stamp, if the robot has moved since the last sweep used.
        """
        returned = np.flatnonzero(np.isfinite(sweep.ranges_m))
        if len(returned) < FEWEST_RETURNS:
            return
        chosen = returned[np.linspace(0, len(returned) - 1, self.settings.beams).astype(int)]
        far = np.flatnonzero(np.isposinf(sweep.ranges_m))
        traced = np.concatenate([chosen, far])[:: max(1, (len(chosen) + len(far)) // TRACED_BEAMS)]
        farthest_m = min(sweep.range_max_m, self.field.diagonal_m)  # beyond the map there is nothing to trace
        seen_m = np.clip(np.nan_to_num(sweep.ranges_m, nan=0.0, posinf=np.inf), 0.0, farthest_m)
        beams = transform_points(self.laser_pose, seen_m[:, None] * sweep.directions)
        if len(self._waiting) == MOST_WAITING:
            self.unplaced += 1
            self.unplaced_in_a_row += 1
        self._waiting.append(_Beams(stamp_s, beams[chosen], beams[traced]))
        self._use_waiting()

    @property
    def pose(self) -> NDArray[np.float64] | None:
        """Where the robot most likely is now (x m, y m, heading rad), map frame; None if nothing is known."""
        if self.newest is None or self._at is None:
            return None
        return compose(self.newest.pose, relative(self._at, self._odometry.log.rows[-1, 1:]))

    def state(self) -> dict[str, Any]:
        """Return the data with which a localizer in a new process continues. Odometry must be continuous."""
        if self._cloud is None or self._at is None:
            return {}
        return {
            "poses": self._cloud.poses,
            "weights": self._cloud.weights,
            "at": self._at,
            "converged": self._convergence.converged,
            "averages": (self._slow, self._fast),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the data that `state` returned."""
        if not state:
            return
        self._cloud = ParticleCloud(state["poses"])
        self._cloud.weights = np.array(state["weights"], float)
        self._at = np.array(state["at"], float)
        self._slow, self._fast = state["averages"]
        self._convergence.converged = bool(state["converged"])

    def _forget(self) -> None:
        self.newest, self._at = None, None
        self._convergence = ConvergenceWatch()
        self._slow = self._fast = 1.0

    def _use_waiting(self) -> None:
        while self._waiting:
            place = self._odometry.at(self._waiting[0].stamp_s)
            if place is None:
                return
            self.unplaced_in_a_row = 0
            beams = self._waiting.popleft()
            if self._moves_to(place.pose):
                self._weigh(beams)

    def _moves_to(self, odometry: NDArray[np.float64]) -> bool:
        """Move the particles by odometry up to a sweep; return whether to use that sweep."""
        step = np.zeros(3) if self._at is None else relative(self._at, odometry)
        way_m = float(np.hypot(step[0], step[1]))
        stands = way_m < self.settings.update_m and abs(step[2]) < self.settings.update_rad
        if stands and self.newest is not None:
            return False
        if self._cloud is not None:
            self._cloud.move(step, self._noise, self._random)
        self._at = odometry
        self._expected = None if self.newest is None else compose(self.newest.pose, step)
        self._travelled_m += way_m
        return True

    def _weigh(self, beams: _Beams) -> None:
        """Weigh the particles by a sweep."""
        if self._cloud is None:
            self._cloud = ParticleCloud(self._fitting(self.settings.max_particles, beams.ends))
        cloud = self._cloud
        fits = self.field.log_likelihoods(cloud.poses, beams.ends)
        fits += self.field.worst * self.field.blocked(cloud.poses, beams.seen)
        cloud.weigh(self.settings.independent_beams * fits)
        self.newest = self._judged(beams, cloud)
        self._resample(cloud, beams.ends, float(cloud.weights @ np.exp(fits)))

    def _judged(self, beams: _Beams, cloud: ParticleCloud) -> Localization:
        """Return the estimate."""
        best = cloud.heaviest_cluster()
        agreement = float((self.field.distances_m(best.pose, beams.ends) < AGREES_M).mean())
        jump_m = 0.0 if self._expected is None else float(np.hypot(*(best.pose - self._expected)[:2]))
        converged = self._convergence.judge(best, jump_m, agreement, self._travelled_m)
        spread_m, spread_rad = cloud.spread(best.pose)
        return Localization(beams.stamp_s, best.pose, converged, spread_m, spread_rad, agreement, len(cloud))

    def _resample(self, cloud: ParticleCloud, ends: NDArray[np.float64], fit: float) -> None:
        """Resample if few particles have most of the weight or other places must be tried."""
        settings = self.settings
        self._slow += SLOW * (fit - self._slow)
        self._fast += FAST * (fit - self._fast)
        least = settings.min_particles if self._convergence.converged else settings.min_searching
        count = cloud.needed(least, settings.max_particles)
        share = max(0.0, 1.0 - self._fast / max(BEARABLE * self._slow, settings.expected_fit))
        added = int(share * settings.max_particles)
        if cloud.effective_count > len(cloud) / 2 and added == 0:
            return
        poses = cloud.drawn(min(count, settings.max_particles - added), self._random)
        self._cloud = ParticleCloud(poses)
        if added:
            self.recoveries += 1
            doubt = min(share, DOUBT) if self._convergence.converged else added / (added + len(poses))
            self._cloud.add(self._fitting(added, ends), doubt)

    def _fitting(self, count: int, ends: NDArray[np.float64]) -> NDArray[np.float64]:
        """Draw poses `(count, 3)` from all over the map where a sweep would fit."""
        every = ends[:: max(1, len(ends) // CANDIDATE_BEAMS)]
        candidates = ParticleCloud(self.field.random_poses(self.settings.candidates, self._random))
        fits = self.field.log_likelihoods(candidates.poses, every)
        candidates.weigh(GENTLE * self.settings.independent_beams * fits)
        return candidates.drawn(count, self._random) + self._random.normal(size=(count, 3)) * JITTER
