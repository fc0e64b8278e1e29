"""Map a place from wheel odometry and a planar laser: the stock robot's SLAM.

The mapper matches each sweep against the ones before it (`scan_tracker`), closes loops over a pose graph
(`loop_closing`, `pose_graph`), and draws the key sweeps into an occupancy grid (`map_renderer`). In outline:
Konolige et al., "Efficient sparse pose adjustment for 2D mapping" (IROS 2010), and Hess et al.,
"Real-time loop closure in 2D LIDAR SLAM" (ICRA 2016).
"""

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.mapping.corrected_track import corrected
from robbie_robots.workers.mapping.key_sweeps import KeySweeps
from robbie_robots.workers.mapping.loop_closing import LoopCloser
from robbie_robots.workers.mapping.map_renderer import MapRenderer
from robbie_robots.workers.mapping.occupancy_grid import GrowingGrid
from robbie_robots.workers.mapping.odometry_deviation import first_guess
from robbie_robots.workers.mapping.redundancy import redundant
from robbie_robots.workers.mapping.scan_matcher import Match
from robbie_robots.workers.mapping.scan_tracker import ScanTracker
from robbie_robots.workers.mapping.slip_watch import SLIP_DEVIATION, SlipWatch
from robbie_robots.workers.odometry_track import OdometryTrack, TrackMoment
from robbie_robots.workers.planar_pose import compose, relative, rotated_information
from robbie_robots.workers.row_log import RowLog

HARDLY_M, HARDLY_RAD = 0.05, 0.03  # a sweep taken nearer to the last one adds no information
KEY_M, KEY_RAD = 0.25, 0.2  # from one key sweep to the next
FARTHEST_M, FARTHEST_RAD = 0.5, 0.4  # way and turns over which odometry leads to the next sweep
FEWEST_HITS = 20
THINNED = 0.1  # share of the key sweeps removed at a time
GAP_S, GAP_M = 2.0, 2.0  # a pause between two sweeps in which the robot moved this far is a gap
SILENCE_S = 2.0  # without odometry for this long, the robot may have been carried
COASTED_M = 0.3  # so may one that stopped in a shorter pause, in which it would have driven this far
STILL_S = 0.2  # from one look at the laser to the next, while odometry stands still
STILL = np.array([0.5, 0.5, 0.1])  # m, m, rad: deviation of odometry that stands still
PAUSES, FEWEST_PAUSES = 15, 3  # newest pauses between sweeps, whose median is the usual one
GAP_PAUSES = 3.0  # a gap is this many times longer
GAP_KNOWN = 0.5  # share of what is known of each axis after it that must come from the sweep
CARRIED = np.array([1.5, 1.5, 0.3])  # m, m, rad: deviation of a robot that may have been carried
GAP_OVERLAP = 0.4  # share of the returns after it that must lie on known surfaces
MOST_WAITING = 10  # sweeps that wait for their odometry
PATIENCE = 5  # odometry messages a sweep waits for one at its own stamp
NOWHERE = np.zeros(3)


@dataclass(frozen=True)
class MapperLimits:
    """Limits of the mapper's memory. `GridMapper.refused` counts the inputs beyond them.

    Attributes:
        cells: Cells of the grid (5 bytes each) in tiles in which something was seen.
        key_sweeps: Key sweeps of the map (some 15 kB each with 360 beams). At the limit, the mapper removes
            redundant ones.
        odometry: Entries of the trajectory (32 bytes each, and 64 for each matched sweep). At the limit, the
            mapper removes the older half.
    """

    cells: int = 60_000_000
    key_sweeps: int = 4_000
    odometry: int = 400_000


@dataclass(frozen=True)
class Certainty:
    """How well the robot knows where it is on its map.

    Attributes:
        covariance: `(3, 3)`, of x (m), y (m) and heading (rad) in the map frame, seen from where it began.
        gaps_open: Number of parts of the map that only odometry joins to its beginning.
        share_beyond_gaps: Share of the key sweeps that are in those parts.
    """

    covariance: NDArray[np.float64]
    gaps_open: int
    share_beyond_gaps: float


@dataclass(frozen=True)
class _WaitingSweep:
    stamp_s: float
    sweep: LaserSweep
    arrival: int  # number of the first odometry entry after the sweep


class GridMapper:
    """Builds a map from a robot's odometry and sweeps, in order of arrival.

    The map frame is the odometry frame as it was at the first sweep.

    Args:
        resolution_m: Edge of a cell.
        max_range_m: Returns from farther away are not used.
        laser_pose: The laser's mounting pose on the robot (x m, y m, heading rad).
        limits: Limits of the mapper's memory.

    Attributes:
        refused: Number of inputs left out, by reason.
        thinned: Number of key sweeps removed to make room.
        gaps_noticed: Number of times that the robot moved without sweeps for a while.
        gaps_open: Number of those after which it was not found on its map. Odometry alone joins what comes
            after to what was before, until a loop is closed.
    """

    def __init__(
        self,
        resolution_m: float = 0.05,
        max_range_m: float = 30.0,
        laser_pose: ArrayLike = (0.0, 0.0, 0.0),
        limits: MapperLimits | None = None,
    ) -> None:
        self.limits = limits or MapperLimits()
        self.max_range_m = max_range_m
        self.laser_pose = np.asarray(laser_pose, float)
        self.refused: Counter[str] = Counter()
        self.thinned = 0
        self.gaps_noticed = 0
        self.gaps_open = 0
        self._keys = KeySweeps()
        self._tracker = ScanTracker(self._keys)
        self._slips = SlipWatch(self._keys)
        self._closer = LoopCloser(self._keys)
        self._renderer = MapRenderer(self._keys, GrowingGrid(resolution_m, self.limits.cells))
        self._odometry = OdometryTrack(self.limits.odometry)
        # Matched sweeps: position in the odometry, laser's pose by odometry, key sweep, pose relative to it.
        self._anchors = RowLog(8, self.limits.odometry)
        self._waiting: deque[_WaitingSweep] = deque()
        self._pauses_s: deque[float] = deque(maxlen=PAUSES)  # between the newest sweeps
        self._newest = (np.inf, NOWHERE, 0.0)  # newest sweep: stamp (s), pose and place by odometry
        self._base = np.zeros(8)  # the anchor from which odometry leads to the next sweep
        self._looked_s = -np.inf  # stamp of the newest sweep that was matched
        self._is_carried = False

    def add_odometry(self, stamp_s: float, pose: ArrayLike) -> None:
        """Add an odometry pose (x m, y m, heading rad; odometry frame)."""
        self._odometry.add(stamp_s, pose)
        self._place_waiting()

    def add_scan(self, stamp_s: float, sweep: LaserSweep) -> None:
        """Add a sweep, for which the mapper uses the odometry pose at the sweep's own stamp.

        The sweep waits until odometry has reached that stamp.
        """
        sweep = sweep.within(self.max_range_m)
        if len(sweep.hits) < FEWEST_HITS:
            self.refused["unusable sweeps" if sweep.problem else "sweeps with too few returns"] += 1
            return
        if len(self._waiting) == MOST_WAITING:
            self._waiting.popleft()
            self.refused["sweeps without odometry"] += 1
        self._waiting.append(_WaitingSweep(stamp_s, sweep, self._odometry.log.end))
        self._place_waiting()

    @property
    def pose(self) -> NDArray[np.float64]:
        """Return the robot's current pose (x m, y m, heading rad), map frame."""
        if not len(self._odometry.log):
            return NOWHERE.copy()
        newest = self._odometry.log.rows[-1, 1:]
        if not len(self._anchors):
            return newest.copy()
        anchor = self._anchors.rows[-1]
        return self._robot(compose(self._corrected(anchor), relative(anchor[1:4], self._laser(newest))))

    def trajectory(self) -> NDArray[np.float64]:
        """Return the robot's past poses, `(M, 4)`: stamp (s), x, y (m), heading (rad), map frame.

        Each odometry message has one row, in order of arrival. Each closed loop corrects the older rows.
        """
        if self._closer.settle():
            self._tracker.forget()
        odometry = self._odometry.log.rows
        if not len(self._anchors):
            return odometry.copy()
        anchors = self._anchors.rows
        rows = anchors[:, 0] - self._odometry.log.forgotten
        poses = corrected(self._laser(odometry[:, 1:]), rows, anchors[:, 1:4], self._corrected(anchors))
        return np.column_stack([odometry[:, 0], self._robot(poses)])

    def grid(
        self, most_cells: int | None = None, most_sweeps: int | None = None
    ) -> tuple[NDArray[np.int8], NDArray[np.float64], float]:
        """Draw the map.

        Args:
            most_cells: If more are known, only a window of this many cells around the robot is returned.
            most_sweeps: Maximum number of sweeps to draw or to move now; `sweeps_behind` says how many wait.

        Returns:
            Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 for unknown (as in ROS's
            nav_msgs/OccupancyGrid); the position of the corner of cell (0, 0) (x, y; m, map frame); and the
            edge of a cell (m).
        """
        grid = self.drawn(most_sweeps)
        window = grid.known()
        if most_cells is not None:
            window = window.around(np.floor(self.pose[:2] / grid.resolution_m), most_cells)
        return (*grid.cells(window), grid.resolution_m)

    def drawn(self, most_sweeps: int | None = None) -> GrowingGrid:
        """Draw the map and return its grid, which later drawing changes. `most_sweeps` is as in `grid`."""
        self._renderer.update(most_sweeps)
        self.refused["sweeps beyond the grid's memory"] = self._renderer.left_out
        return self._renderer.grid

    @property
    def known_cells(self) -> tuple[int, int]:
        """Rows and columns of the smallest window that contains all that is drawn."""
        return self._renderer.grid.known().shape

    @property
    def sweeps_behind(self) -> int:
        """Number of key sweeps that wait to be drawn, or to be moved to their new poses."""
        return self._renderer.behind

    @property
    def loops_closed(self) -> int:
        """Number of loops closed."""
        return self._closer.closed

    @property
    def loops_taken_back(self) -> int:
        """Number of loops that later ones contradicted."""
        return self._closer.taken_back

    @property
    def odometry_deviation(self) -> NDArray[np.float64]:
        """Odometry's standard deviation along, across, in heading; 1 for that of an uncalibrated robot."""
        return self._tracker.odometry_deviation.share

    @property
    def systematic_errors(self) -> NDArray[np.float64]:
        """What was learnt of scale (share), the laser's angle (rad), rad per m and rad per rad."""
        return self._tracker.odometry_deviation.systematic

    @property
    def slips_noticed(self) -> int:
        """Number of times that odometry was far from what the laser saw."""
        return self._slips.noticed

    @property
    def slips_not_undone(self) -> int:
        """Number of slips after which the robot was not found in its map: the map may be bent there."""
        return self._slips.not_undone

    @property
    def is_certain(self) -> bool:
        """Whether the newest sweep fitted the map. If not, `pose` is only odometry's guess."""
        return not self._slips.lost

    def certainty(self) -> Certainty:
        """Return how well the robot knows where it is. This takes longer with more key sweeps."""
        if not len(self._anchors):
            return Certainty(np.zeros((3, 3)), 0, 0.0)
        anchor, graph = self._anchors.rows[-1], self._keys.graph
        turned = graph.poses[0, 2]
        covariance = rotated_information(graph.covariance_between(0, int(anchor[4])), turned)
        step = relative(anchor[1:4], self._laser(self._odometry.log.rows[-1, 1:]))
        deviation = self._tracker.odometry_deviation.over(step)
        if not self.is_certain:
            deviation = np.maximum(deviation, SLIP_DEVIATION)
        covariance += rotated_information(np.diag(deviation**2), self._corrected(anchor)[2])
        parts = graph.parts()
        return Certainty(covariance, int(parts.max()), float((parts != parts[0]).mean()))

    @property
    def key_sweeps(self) -> int:
        """Number of key sweeps in the map."""
        return len(self._keys)

    def state(self) -> dict[str, Any]:
        """Return the mapper's state as plain data and arrays. The next message may change the arrays."""
        return {
            "settings": {
                "resolution_m": self._renderer.grid.resolution_m,
                "max_range_m": self.max_range_m,
                "laser_pose": self.laser_pose.tolist(),
            },
            "limits": asdict(self.limits),
            "refused": dict(self.refused),
            "thinned": self.thinned,
            "gaps": {"noticed": self.gaps_noticed, "open": self.gaps_open},
            "newest": np.array([self._newest[0], *self._newest[1], self._newest[2]]),
            "base": self._base.copy(),
            "carried": {"looked_s": self._looked_s, "now": self._is_carried},
            "odometry": self._odometry.log.state(),
            "anchors": self._anchors.state(),
            "keys": self._keys.state(),
            "loops": self._closer.state(),
            "slips": self._slips.state(),
            "tracked_from_m": self._tracker.begin_m,
            "odometry_deviation": self._tracker.odometry_deviation.state(),
            "pauses_s": np.array(self._pauses_s),
            "map": self._renderer.state(),
            "waiting": [
                {"stamp_s": one.stamp_s, "arrival": one.arrival, "sweep": one.sweep.state()}
                for one in self._waiting
            ],
        }

    @staticmethod
    def from_state(state: Mapping[str, Any]) -> "GridMapper":
        """Make a mapper that continues exactly from a `state`, which stores ranges as float32."""
        mapper = GridMapper(**state["settings"], limits=MapperLimits(**state["limits"]))
        mapper.refused.update(state["refused"])
        mapper.thinned = state.get("thinned", 0)
        gaps = state.get("gaps", {"noticed": 0, "open": 0})
        mapper.gaps_noticed, mapper.gaps_open = gaps["noticed"], gaps["open"]
        if "newest" in state:
            stamp_s, *pose, position = [*state["newest"], 0.0][:5]
            mapper._newest = float(stamp_s), np.array(pose), float(position)
        mapper._odometry.log.restore(state["odometry"])
        mapper._anchors.restore(state["anchors"])
        if len(mapper._anchors):
            mapper._base = np.array(state.get("base", mapper._anchors.rows[-1]))
        if "carried" in state:
            mapper._looked_s, mapper._is_carried = state["carried"]["looked_s"], state["carried"]["now"]
        mapper._keys.restore(state["keys"])
        mapper._closer.restore(state["loops"])
        mapper._slips.restore(state["slips"])
        mapper._tracker.begin(float(state["tracked_from_m"]))
        if "odometry_deviation" in state:
            mapper._tracker.odometry_deviation.restore(state["odometry_deviation"])
            mapper._pauses_s.extend(state["pauses_s"].tolist())
        mapper._renderer.restore(state["map"])
        for one in state["waiting"]:
            sweep = LaserSweep.from_state(one["sweep"])
            mapper._waiting.append(_WaitingSweep(one["stamp_s"], sweep, one["arrival"]))
        return mapper

    def _place_waiting(self) -> None:
        """Use the waiting sweeps whose odometry has arrived, in order."""
        while self._waiting:
            first = self._waiting[0]
            place = self._odometry.at(first.stamp_s)
            if place is None:
                if not len(self._odometry.log) or self._odometry.log.end - first.arrival < PATIENCE:
                    return
                # No odometry has this stamp: the entry that arrived just before the sweep is the nearest.
                place = self._odometry.numbered(first.arrival - 1)
            self._waiting.popleft()
            if self._odometry.is_in_pause(place, HARDLY_M, HARDLY_RAD):
                self.refused["sweeps in a pause of odometry"] += 1
                continue
            self._use(first.stamp_s, first.sweep, place)

    def _use(self, stamp_s: float, sweep: LaserSweep, place: TrackMoment) -> None:
        """Match a sweep and anchor the trajectory at it."""
        odometry = self._laser(place.pose)
        is_gap = self._is_gap(stamp_s, odometry, place.position)
        self._newest = stamp_s, odometry, place.position
        if not len(self._keys):
            self._anchor(place, odometry, self._keys.add(sweep, odometry), NOWHERE)
            self._base = self._anchors.rows[-1].copy()
            return
        last = self._anchors.rows[-1]
        step = relative(last[1:4], odometry)
        is_still = not is_gap and np.hypot(step[0], step[1]) < HARDLY_M and abs(step[2]) < HARDLY_RAD
        if place.position < last[0] or (is_still and abs(stamp_s - self._looked_s) < STILL_S):
            return
        self._looked_s = stamp_s
        if len(self._keys) >= self.limits.key_sweeps:
            self._thin()
        if len(self._keys) >= self.limits.key_sweeps:
            self.refused["sweeps beyond the limit of key sweeps"] += 1
            return
        noticed = self._slips.noticed
        calibration, before = self._tracker.odometry_deviation, self._corrected(self._base)
        raw = relative(self._base[1:4], odometry)
        step, moved = calibration.corrected(raw), self._odometry.moved(self._base[0], place.position)
        if is_gap:
            match = self._match_after_gap(sweep, before, step, (self._base[0], place.position))
        elif is_still:
            match = self._match_while_still(sweep, before, step)
        else:  # Nobody knows where a carried robot was put down.
            deviation = np.maximum(calibration.over(raw, moved), STILL if self._is_carried else 0.0)
            match = self._checked_match(sweep, before, step, deviation)
        if match is None:
            return
        has_slipped = is_gap or is_still or self._is_carried or self._slips.noticed > noticed
        self._is_carried = is_still
        is_bridged = is_gap and bool(match.known.min() >= GAP_KNOWN)
        is_key = self._place(match, sweep, place, must_be_key=has_slipped and not is_bridged)
        if is_key or has_slipped or moved[0] > FARTHEST_M or moved[2] > FARTHEST_RAD:
            if has_slipped:
                calibration.interrupt()
            else:
                judging = self._tracker.judging(sweep, match, compose(before, step), first_guess(moved))
                calibration.learn(raw, relative(before, judging.pose), moved, judging.known)
            self._base = self._anchors.rows[-1].copy()
        if is_key:
            self._closer.look()
            self._tracker.forget()

    def _place(self, match: Match, sweep: LaserSweep, place: TrackMoment, must_be_key: bool) -> bool:
        """Anchor the trajectory at a matched sweep. Return whether it has become a key sweep.

        A sweep by which the robot was found elsewhere must be one, because only an edge of the graph knows
        how uncertain that place is.
        """
        odometry, base = self._laser(place.pose), len(self._keys) - 1
        offset = relative(self._keys.poses[base], match.pose)
        is_near = np.hypot(offset[0], offset[1]) < KEY_M and abs(offset[2]) < KEY_RAD
        if is_near and not must_be_key:
            self._anchor(place, odometry, base, offset)
            return False
        information = rotated_information(match.information, -self._keys.poses[base, 2])
        key = self._keys.add(sweep, match.pose)
        self._keys.graph.add_edge(base, key, offset, information)
        self._anchor(place, odometry, key, NOWHERE)
        return True

    def _checked_match(
        self,
        sweep: LaserSweep,
        before: NDArray[np.float64],
        step: NDArray[np.float64],
        deviation: NDArray[np.float64],
    ) -> Match | None:
        """Match a sweep. Return None if it does not fit the map, as after a slip of odometry."""
        guess, given_up = compose(before, step), self._slips.not_undone
        match = self._slips.checked(
            sweep,
            guess,
            deviation,
            self._tracker.match(sweep, before, step, deviation),
            self._tracker.reference(),
        )
        if self._slips.not_undone > given_up:
            self._begin_at(guess)
        return match

    def _match_while_still(
        self, sweep: LaserSweep, before: NDArray[np.float64], step: NDArray[np.float64]
    ) -> Match | None:
        """Match a sweep while odometry stands still. Return None unless the robot is carried or pushed."""
        if not self.is_certain:
            return None
        match = self._tracker.match(sweep, before, step, STILL)
        is_carried = self._slips.sees_motion(sweep, compose(before, step), match, self._is_carried)
        return match if is_carried else None

    def _match_after_gap(
        self,
        sweep: LaserSweep,
        before: NDArray[np.float64],
        step: NDArray[np.float64],
        positions: tuple[float, float],
    ) -> Match | None:
        """Find the robot on its map after a gap.

        Where the map knows nothing of what the sweep shows, take odometry's word for it.
        """
        guess, moved = compose(before, step), self._odometry.moved(*positions)
        deviation = first_guess(moved)  # what was learnt need not hold where nothing was seen
        silence_s, coasted_m = self._odometry.longest_pause(*positions)
        if silence_s >= SILENCE_S or coasted_m >= COASTED_M:
            deviation = np.maximum(deviation, CARRIED)
        self.gaps_noticed += 1
        match = self._slips.bridged(sweep, guess, deviation)
        if match is not None:
            self.gaps_open += bool(match.known.min() < GAP_KNOWN)
            return match
        match = self._checked_match(sweep, before, step, deviation)
        if match is None or not self.is_certain:
            return match
        overlaps = match.on_surface.mean() >= GAP_OVERLAP
        self.gaps_open += not overlaps or bool(match.known.min() < GAP_KNOWN)
        if overlaps:
            return match
        self._begin_at(guess)
        return replace(match, pose=guess, information=np.diag(deviation**-2.0))

    def _is_gap(self, stamp_s: float, odometry: NDArray[np.float64], position: float) -> bool:
        """Return whether a sweep follows an unusually long pause in which the robot may have moved far.

        Odometry says so, or was silent as well.
        """
        pause_s = stamp_s - self._newest[0]
        if not 0.0 < pause_s < np.inf:
            return False
        is_known = len(self._pauses_s) >= FEWEST_PAUSES
        usual_s = float(np.median(self._pauses_s)) if is_known else 0.0
        self._pauses_s.append(pause_s)
        if pause_s < GAP_PAUSES * usual_s:
            return False
        step = relative(self._newest[1], odometry)
        # At the beginning, each sweep may come as late as that.
        is_long = is_known and pause_s >= GAP_S and np.hypot(step[0], step[1]) >= GAP_M
        silence_s, coasted_m = self._odometry.longest_pause(self._newest[2], position)
        is_silent = silence_s >= SILENCE_S or (coasted_m >= COASTED_M and silence_s >= pause_s / 2)
        return bool(is_silent or is_long)

    def _begin_at(self, guess: NDArray[np.float64]) -> None:
        """Match only the sweeps from here on, because the robot was not found on the map before."""
        apart = np.hypot(*(guess - self._keys.poses[-1])[:2])
        self._tracker.begin(self._keys.travelled_m[-1] + apart - 1e-6)

    def _thin(self) -> None:
        """Make room by removing redundant key sweeps."""
        self._closer.settle()
        self._tracker.forget()
        count = max(1, int(THINNED * self.limits.key_sweeps))
        numbers = redundant(self._keys.poses, self._keys.travelled_m, count)
        if not numbers:
            return
        self._renderer.forget(numbers)
        poses = self._keys.poses
        heirs = self._keys.remove(numbers)
        anchors = self._anchors.rows
        keys = anchors[:, 4].astype(int)
        offsets = compose(relative(poses[heirs[keys]], poses[keys]), anchors[:, 5:8])
        moved = heirs[keys] != keys
        anchors[moved, 5:8] = offsets[moved]
        anchors[:, 4] = heirs[keys] - np.searchsorted(numbers, heirs[keys])
        self._base = anchors[-1].copy()
        self._closer.renumber(heirs - np.searchsorted(numbers, heirs))
        self.thinned += len(numbers)

    def _anchor(
        self, place: TrackMoment, odometry: NDArray[np.float64], key: int, offset: NDArray[np.float64]
    ) -> None:
        self._anchors.add([place.position, *odometry, key, *offset])

    def _corrected(self, anchors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the laser's poses at anchors `(..., 8)` by the current map: `(..., 3)`, map frame."""
        return compose(self._keys.poses[anchors[..., 4].astype(int)], anchors[..., 5:8])

    def _laser(self, robot: NDArray[np.float64]) -> NDArray[np.float64]:
        return compose(robot, self.laser_pose)

    def _robot(self, laser: NDArray[np.float64]) -> NDArray[np.float64]:
        return compose(laser, relative(self.laser_pose, NOWHERE))
