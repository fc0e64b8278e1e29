"""Shares targets among the robots of a team, so that the last one is home as early as possible.

A sequential auction with the rule MiniMax of Lagoudakis et al., "Auction-based multi-robot routing" (RSS,
2005): a robot's bid for a target is the length of the longest tour if it took that target. Each robot's tour
begins where it is and ends at its home. Then single targets are moved to better places.

Every robot of the team computes this alone. They know almost the same, so they come to almost the same
result; their claims settle the rest.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Costs = NDArray[np.float64]
Tour = list[int]

SUM_SHARE = 0.2
"""How much the length of all tours counts, compared with the length of the longest."""
KEEP_M = 3.0
"""How much shorter a tour counts that contains the target to which its robot drives already."""
MOST_PASSES = 4
NO_WAY_M = 1e3
"""A place to which no way is known counts as this far."""


@dataclass(frozen=True)
class TourCosts:
    """What the tours of `R` robots over `T` targets are made of, m; +inf where no way leads.

    Attributes:
        begin_m: `(R, T)`, from where each robot is to each target; +inf: it must not go there.
        between_m: `(T, T)`, from target to target.
        end_m: `(R, T)`, from each target to each robot's home.
        back_m: `(R,)`, from where each robot is to its home.
        work_m: `(T,)`, the way that a robot could drive while it does the work at each target.
        claimed: for each robot, the target to which it drives already. None: none of these.
    """

    begin_m: Costs
    between_m: Costs
    end_m: Costs
    back_m: Costs
    work_m: Costs
    claimed: tuple[int | None, ...]


def share_targets(costs: TourCosts) -> list[Tour]:
    """Return the tour of each robot: which targets are its own, in the order in which it visits them."""
    planner = _Planner(costs)
    targets = range(len(costs.work_m))
    open_targets = set(targets)
    while open_targets:
        target = min(open_targets, key=lambda one: (planner.best_place(one)[0], one))
        planner.insert(target)
        open_targets.remove(target)
    for _ in range(MOST_PASSES):
        if not any([planner.move(target) for target in targets]):
            break
    return planner.tours


class _Planner:
    """Tours that grow target by target."""

    def __init__(self, costs: TourCosts) -> None:
        def finite(costs_m: Costs) -> list[list[float]]:
            limited: list[list[float]] = np.minimum(costs_m, NO_WAY_M).tolist()
            return limited

        self._begin, self._end = finite(costs.begin_m), finite(costs.end_m)
        self._between, self._work = finite(costs.between_m), finite(costs.work_m[None])[0]
        self._claimed = costs.claimed
        self.tours: list[Tour] = [[] for _ in self._begin]
        self._back: list[float] = np.minimum(costs.back_m, NO_WAY_M).tolist()
        self._lengths: list[float] = self._back.copy()

    def best_place(self, target: int) -> tuple[float, int, int, float]:
        """Return the cheapest way to add a target: the plan's cost then, robot, position, tour's growth."""
        places = []
        for robot, tour in enumerate(self.tours):
            position, more_m = min(
                ((position, self._detour_m(robot, position, target)) for position in range(len(tour) + 1)),
                key=lambda place: place[1],
            )
            more_m += self._extra_m(robot, target)
            places.append((self._cost_m(robot, more_m), robot, position, more_m))
        return min(places)

    def insert(self, target: int) -> None:
        """Add a target where that is cheapest."""
        _, robot, position, more_m = self.best_place(target)
        self.tours[robot].insert(position, target)
        self._lengths[robot] += more_m

    def move(self, target: int) -> bool:
        """Move a target to where it is cheapest; return whether the plan is better now."""
        before_m = self._cost_m(0, 0.0)
        robot = next(one for one, tour in enumerate(self.tours) if target in tour)
        position = self.tours[robot].index(target)
        del self.tours[robot][position]
        self._lengths[robot] -= self._detour_m(robot, position, target) + self._extra_m(robot, target)
        self.insert(target)
        return self._cost_m(0, 0.0) < before_m - 1e-6

    def _cost_m(self, robot: int, more_m: float) -> float:
        """Return the plan's cost if the tour of one robot were this much longer."""
        lengths: list[float] = self._lengths.copy()
        lengths[robot] += more_m
        return max(lengths) + SUM_SHARE * sum(lengths)

    def _extra_m(self, robot: int, target: int) -> float:
        """Return how much longer a tour gets by a target itself, wherever it stands on the tour."""
        barred_m = NO_WAY_M * (self._begin[robot][target] >= NO_WAY_M)
        kept_m = KEEP_M * (self._claimed[robot] == target)
        extra_m: float = self._work[target] - kept_m + barred_m
        return extra_m

    def _detour_m(self, robot: int, position: int, target: int) -> float:
        """Return how much longer a tour gets by way of a target that stands at a position of it."""
        tour = self.tours[robot]
        to_m = self._begin[robot][target] if position == 0 else self._between[tour[position - 1]][target]
        from_m = self._end[robot][target] if position == len(tour) else self._between[target][tour[position]]
        return to_m + from_m - self._leg_m(robot, position)

    def _leg_m(self, robot: int, position: int) -> float:
        """Return the length of the leg of a tour that ends at a position."""
        tour = self.tours[robot]
        if not tour:
            return self._back[robot]
        if position == 0:
            return self._begin[robot][tour[0]]
        if position == len(tour):
            return self._end[robot][tour[-1]]
        return self._between[tour[position - 1]][tour[position]]
