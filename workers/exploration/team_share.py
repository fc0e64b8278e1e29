"""Which targets are this robot's own, and which it leaves to the other robots of its team."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.exploration.drivable_ground import SNAP_M, DrivableGround
from robbie_robots.workers.exploration.team_claims import Claim
from robbie_robots.workers.exploration.team_tours import TourCosts, share_targets
from robbie_robots.workers.navigation.path_planner import costs_between

Points = NDArray[np.float64]
Costs = NDArray[np.float64]

MOST_ON_TOURS = 24
"""Of more targets, those farthest from all robots are on no tour: each belongs to the robot nearest to it."""
SAME_M = 0.8
"""A target this near to the one that a robot has claimed is the one that it drives to."""


@dataclass(frozen=True)
class SharedTarget:
    """A target, as the team shares it.

    Attributes:
        goal: `(3,)`, where a robot goes for it, x, y (m) and heading (rad), map frame.
        about_xy_m: `(2,)`, m, map frame: what it goes there for.
        work_m: the way that a robot could drive while it does the work there.
        is_known: whether the other robots know of it. False: only this robot can do it.
    """

    goal: Points
    about_xy_m: Points
    work_m: float
    is_known: bool = True


@dataclass(frozen=True)
class Member:
    """A robot of the team.

    Attributes:
        ways_m: `(H, W)`, cost of its way to each cell of the map's grid.
        home_xy_m: `(2,)`, m, map frame: where it drives when no work is left. None: not known.
        target_xy_m: `(2,)`, m, map frame: the target to which it drives already. None: it has none.
    """

    ways_m: Costs
    home_xy_m: Points | None
    target_xy_m: Points | None


def own_work(
    around: DrivableGround, own: Member, work: Sequence[SharedTarget], others: Sequence[Claim]
) -> list[int]:
    """Return the indices of the targets that are this robot's own, in the order of its tour.

    Args:
        around: the newest map.
        own: this robot.
        work: all targets.
        others: the claims of the other robots that look for work.
    """
    everything = list(range(len(work)))
    ways = [(claim, around.ways_from(claim.pose)) for claim in others]
    team = [own] + [
        Member(found.cost_m, claim.home_xy_m, claim.target_xy_m) for claim, found in ways if found is not None
    ]
    if len(team) == 1 or not work:
        return everything
    cells = [around.grid.cell(one.goal) for one in work]
    begin_m = np.array([[member.ways_m[cell] for cell in cells] for member in team])
    begin_m[1:, [not one.is_known for one in work]] = np.inf
    on_tours = np.sort(np.argsort(begin_m.min(axis=0), kind="stable")[:MOST_ON_TOURS]).tolist()
    costs = _tour_costs(around, team, [work[index] for index in on_tours], begin_m[:, on_tours])
    mine = [on_tours[target] for target in share_targets(costs)[0]]
    mine += [index for index in everything if index not in on_tours and begin_m[:, index].argmin() == 0]
    # The others may have given up what is theirs: if no robot has a target, this one tries everything.
    return mine if mine or any(member.target_xy_m is not None for member in team[1:]) else everything


def _tour_costs(
    around: DrivableGround, team: Sequence[Member], work: Sequence[SharedTarget], begin_m: Costs
) -> TourCosts:
    grid, count = around.grid, len(work)
    cells = [grid.cell(one.goal) for one in work]
    homes = {
        robot: home
        for robot, member in enumerate(team)
        if member.home_xy_m is not None
        and (home := grid.nearest(grid.drivable, member.home_xy_m, SNAP_M)) is not None
    }
    between_m = costs_between(grid, [*cells, *homes.values()])
    end_m, back_m = np.zeros((len(team), count)), np.zeros(len(team))
    for row, (robot, home) in enumerate(homes.items(), start=count):
        end_m[robot], back_m[robot] = between_m[row, :count], team[robot].ways_m[home]
    about = np.array([one.about_xy_m for one in work])
    return TourCosts(
        begin_m=begin_m,
        between_m=between_m[:count, :count],
        end_m=end_m,
        back_m=back_m,
        work_m=np.array([one.work_m for one in work]),
        claimed=tuple(_nearest(about, member.target_xy_m) for member in team),
    )


def _nearest(about_xy_m: Points, target_xy_m: Points | None) -> int | None:
    """Return which of the places `(N, 2)`, m, is the target; None if none is."""
    if target_xy_m is None:
        return None
    away_m = np.hypot(*(about_xy_m - target_xy_m).T)
    nearest = int(np.argmin(away_m))
    return nearest if away_m[nearest] <= SAME_M else None
