"""Possible targets of the rescue robot: frontiers to explore, walls to search, victims to approach."""

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from robbie_robots.workers.exploration.drivable_ground import DrivableGround
from robbie_robots.workers.exploration.frontiers import Frontier, find_frontiers
from robbie_robots.workers.exploration.team_claims import SeenInVain, TeamClaims
from robbie_robots.workers.exploration.team_share import Member, SharedTarget, own_work
from robbie_robots.workers.maps.navigation_grid import Cell
from robbie_robots.workers.planar_pose import rotate, wrap_angle
from robbie_robots.workers.rescue.mission_states import MissionSettings, MissionState
from robbie_robots.workers.rescue.search_views import search_views
from robbie_robots.workers.rescue.searched_walls import ALL_EIGHT, SEARCHED, UNSEARCHED, WallFronts

Points = NDArray[np.float64]
Costs = NDArray[np.float64]
"""Path cost to each cell, m; +inf where no path leads or where the robot must not be sent."""

NEAR_FRONTIER_M = 0.5
SAME_M = 0.4
STAY_M = 0.8
TURN_M_PER_RAD = 0.25
GAIN, MAX_GAIN_M = 0.4, 2.0
# Frontiers come first: on the way to them the camera already searches many walls.
SEARCH_LATER_M = 1.0
VICTIM_FIRST_M = 2.0
VICTIM_FROM_M = (0.6, 1.3)
VICTIM_SLANT_RAD = 0.7
REMEMBERED = 64
MAPS_DIFFER_M = 0.1
WORK_M = {MissionState.EXPLORE: 4.0, MissionState.SEARCH: 1.0, MissionState.APPROACH: 2.0}
"""The way that a robot could drive while it does the work at a target, or behind a frontier: a guess."""
KNOWN_TO_ALL = (MissionState.EXPLORE, MissionState.SEARCH)
"""Robots do not tell one another of suspected victims, only of those that need no more views."""


@dataclass(frozen=True)
class RescueTarget:
    """Something to do at a place.

    Attributes:
        state: what the robot is doing on its way there.
        goal: `(3,)`, x, y (m) and heading (rad), map frame.
        about_xy_m: `(2,)`, m, map frame: the point to look at from there.
        cost_m: path cost minus the target's bonus.
        way_m: path cost.
    """

    state: MissionState
    goal: Points
    about_xy_m: Points
    cost_m: float
    way_m: float


class MissionMap(DrivableGround):
    """A map as the mission needs it: where the robot can drive, and which walls there are.

    Args:
        cells: Occupancy in percent `(H, W) int8`, row 0 at the smallest y, -1 unknown.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
        settings: How far paths and goals keep from obstacles.

    Attributes:
        fronts: the walls.
    """

    def __init__(
        self,
        cells: NDArray[np.int8],
        resolution_m: float,
        corner_xy_m: ArrayLike,
        settings: MissionSettings,
    ) -> None:
        super().__init__(cells, resolution_m, corner_xy_m, settings)
        self.fronts = WallFronts(cells, resolution_m, corner_xy_m)


class MissionTargets:
    """Finds targets, and remembers those that the robot gave up.

    Attributes:
        frontiers: the frontiers of the latest map examined, longest first.
        are_left_to_others: whether the only targets are those that other robots drive to.
    """

    def __init__(self, settings: MissionSettings) -> None:
        self.frontiers: list[Frontier] = []
        self.are_left_to_others = False
        self._settings = settings
        self._given_up: deque[tuple[str, float, float, bool]] = deque(maxlen=REMEMBERED)

    @property
    def seen_in_vain(self) -> tuple[SeenInVain, ...]:
        """Return the targets that the robot gave up where it was there, for the other robots."""
        return tuple(SeenInVain(kind, (x, y)) for kind, x, y, was_there in self._given_up if was_there)

    def give_up(self, target: RescueTarget, *, was_there: bool) -> None:
        """Exclude this target, and those of its kind at almost the same place.

        Args:
            target: the target.
            was_there: False: the robot did not get there, and another one may.
        """
        x, y = target.about_xy_m.tolist()
        self._given_up.append((target.state.name, x, y, was_there))

    def memory(self) -> list[list[Any]]:
        """Return the targets that were given up, as plain data."""
        return [list(given_up) for given_up in self._given_up]

    def remember(self, memory: Iterable[Sequence[Any]]) -> None:
        """Restore the data that `memory` returned."""
        self._given_up.clear()
        self._given_up.extend((kind, x, y, was_there) for kind, x, y, was_there in memory)

    def best(
        self,
        around: MissionMap,
        pose: Points,
        searched: "SearchedGrid | None",
        suspected: Iterable[tuple[Points, float]],
        current: RescueTarget | None,
        claims: TeamClaims,
        home: Points | None = None,
    ) -> tuple[RescueTarget | None, bool]:
        """Choose what to do next.

        Args:
            around: the newest map.
            pose: the robot's x, y (m) and heading (rad), map frame.
            searched: which walls were searched. None: no camera works.
            suspected: x, y (m) and facing (rad) of the victims to approach.
            current: the target so far.
            claims: what other robots drive to.
            home: x, y (m), map frame, where the robot drives when no work is left. None: not known.

        Returns:
            The best target, or None if no work is left; and whether the robot stands on drivable ground.
        """
        ways = around.ways_from(pose)
        if ways is None:
            return None, False
        ways_m = np.where(around.goals, ways.cost_m, np.inf)
        targets = list(self._frontiers(around, ways_m, pose))
        if searched is not None:
            targets += self._walls(around, ways_m, searched)
            targets += self._victims(around, ways_m, suspected)
        targets = [target for target in targets if not self._is_given_up(target, claims)]
        own = Member(ways.cost_m, home, None if current is None else current.about_xy_m)
        work = [
            SharedTarget(target.goal, target.about_xy_m, WORK_M[target.state], target.state in KNOWN_TO_ALL)
            for target in targets
        ]
        mine = own_work(around, own, work, claims.working)
        costs_m = [
            self._cost_m(target, current, claims) if index in mine else math.inf
            for index, target in enumerate(targets)
        ]
        best = int(np.argmin(costs_m)) if costs_m else 0
        self.are_left_to_others = bool(costs_m) and math.isinf(costs_m[best])
        return targets[best] if costs_m and not self.are_left_to_others else None, True

    def _frontiers(self, around: MissionMap, ways_m: Costs, pose: Points) -> Iterator[RescueTarget]:
        grid = around.grid
        reached = np.isfinite(ways_m)
        self.frontiers = find_frontiers(grid, self._settings.min_frontier_m)
        for frontier in self.frontiers:
            cell = grid.nearest(reached, frontier.middle_xy_m, NEAR_FRONTIER_M)
            if cell is None:
                continue
            way_m = float(ways_m[cell])
            goal = _facing(grid.middles_m(cell), frontier.middle_xy_m)
            dx, dy = goal[:2] - pose[:2]
            turn_rad = abs(math.remainder(math.atan2(dy, dx) - pose[2], math.tau))
            cost_m = way_m + TURN_M_PER_RAD * turn_rad - GAIN * min(frontier.length_m, MAX_GAIN_M)
            yield RescueTarget(MissionState.EXPLORE, goal, frontier.middle_xy_m, cost_m, way_m)

    def _walls(self, around: MissionMap, ways_m: Costs, searched: "SearchedGrid") -> Iterator[RescueTarget]:
        todo = ~searched.holds(around.fronts.middles_m)
        views = search_views(around.grid, ways_m, around.fronts, todo, self._settings.min_wall_m)
        for view in views:
            goal = _facing(around.grid.middles_m(view.cell), view.look_at_xy_m)
            cost_m = view.cost_m + SEARCH_LATER_M - GAIN * min(view.length_m, MAX_GAIN_M)
            yield RescueTarget(MissionState.SEARCH, goal, view.look_at_xy_m, cost_m, view.cost_m)

    def _victims(
        self, around: MissionMap, ways_m: Costs, suspected: Iterable[tuple[Points, float]]
    ) -> Iterator[RescueTarget]:
        reached = np.argwhere(np.isfinite(ways_m))
        places = around.grid.middles_m(reached)
        for victim, facing_rad in suspected:
            offset = places - victim
            distance = np.hypot(*offset.T)
            aside = np.abs(wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - facing_rad))
            good = (distance >= VICTIM_FROM_M[0]) & (distance <= VICTIM_FROM_M[1])
            good &= aside <= VICTIM_SLANT_RAD
            if good.any():
                cells = reached[good]
                cell: Cell = tuple(cells[np.argmin(ways_m[tuple(cells.T)])].tolist())
                goal = _facing(around.grid.middles_m(cell), victim)
                way_m = float(ways_m[cell])
                yield RescueTarget(MissionState.APPROACH, goal, victim, way_m - VICTIM_FIRST_M, way_m)

    def _is_given_up(self, target: RescueTarget, claims: TeamClaims) -> bool:
        own = [(kind, (x, y)) for kind, x, y, _ in self._given_up]
        return any(
            kind == target.state.name and math.dist(target.about_xy_m, xy_m) <= SAME_M
            for kind, xy_m in [*own, *claims.seen_in_vain]
        )

    def _cost_m(self, target: RescueTarget, current: RescueTarget | None, claims: TeamClaims) -> float:
        """Return a target's cost, less if it is the current one, more if another robot drives near it."""
        is_current = current is not None and target.state is current.state
        if current is not None and math.dist(target.about_xy_m, current.about_xy_m) > SAME_M:
            is_current = False
        extra_m = claims.extra_cost_m(target.about_xy_m, target.way_m, is_current=is_current)
        return target.cost_m - STAY_M * is_current + extra_m


class SearchedGrid:
    """Which walls were searched, as a grid like the map: 100 searched, 0 not.

    Args:
        cells: `(H, W) int8`, row 0 at the smallest y.
        resolution_m: Edge of a cell.
        corner_xy_m: Position of the outer corner of cell (0, 0), m, map frame.
    """

    def __init__(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike) -> None:
        self.cells = cells
        self.resolution_m = resolution_m
        self.corner_xy_m = np.asarray(corner_xy_m, float)
        self.of_others: tuple[tuple[SearchedGrid, Points], ...] = ()
        """Walls that other robots have searched, each with the pose of its map's frame in the map frame."""

    @property
    def ratio(self) -> float:
        """Return the ratio of the walls that this robot has searched; NaN if there are none."""
        walls = int((self.cells >= 0).sum())
        return float((self.cells == SEARCHED).sum()) / walls if walls else math.nan

    def widened(self, min_wall_m: float) -> "SearchedGrid":
        """Return the grid as another robot uses it: maps of robots differ a little.

        Cells around searched ones count as searched. So do pieces of wall that this robot has not searched
        because they are too short, beside searched ones. Otherwise, the other robot would come for a piece
        that is just long enough on its own map.

        Args:
            min_wall_m: Shorter pieces of wall are not worth a visit.
        """
        pieces, count = ndimage.label(self.cells == UNSEARCHED, ALL_EIGHT)
        is_short = np.bincount(pieces.ravel(), minlength=count + 1) * self.resolution_m < min_wall_m
        beside = np.unique(pieces[ndimage.binary_dilation(self.cells == SEARCHED, ALL_EIGHT)])
        left_out = np.isin(pieces, beside[(beside > 0) & is_short[beside]])
        searched = np.where(left_out, SEARCHED, self.cells).astype(np.int8)
        side = 2 * math.ceil(MAPS_DIFFER_M / self.resolution_m) + 1
        return SearchedGrid(ndimage.maximum_filter(searched, side), self.resolution_m, self.corner_xy_m)

    def holds(self, points_m: Points) -> NDArray[np.bool_]:
        """Return which of the points `(N, 2)`, m, map frame, were searched by this robot or another one."""
        searched = self._holds(points_m)
        for grid, pose in self.of_others:
            searched |= grid.holds(rotate(-pose[2], points_m - pose[:2]))
        return searched

    def _holds(self, points_m: Points) -> NDArray[np.bool_]:
        column, row = np.floor((points_m - self.corner_xy_m) / self.resolution_m).astype(int).T
        inside = (row >= 0) & (row < self.cells.shape[0]) & (column >= 0) & (column < self.cells.shape[1])
        searched: NDArray[np.bool_] = inside & (
            self.cells[np.where(inside, row, 0), np.where(inside, column, 0)] == SEARCHED
        )
        return searched


def _facing(place: Points, about: Points) -> Points:
    """Return the pose at a place that faces another."""
    dx, dy = about - place
    return np.array([*place, math.atan2(dy, dx)])
