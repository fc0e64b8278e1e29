"""Plans how an arm moves: inverse kinematics, ways around obstacles, straight lines, and their timing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from robbie_robots.workers.manipulation.arm_model import ArmModel
from robbie_robots.workers.manipulation.collisions import CollisionWorld
from robbie_robots.workers.manipulation.errors import NoWay, Unreachable

Floats = NDArray[np.float64]

RESTARTS = 100
CHECK_RAD = 0.02
"""Distance of the positions that are checked on a way."""
LINE_STEP_M = 0.005
LINE_STEP_RAD = 0.05
JUMP_RAD = 0.25
"""No joint turns more than this from step to step of a straight line."""


def reach(
    arm: ArmModel,
    surroundings: CollisionWorld,
    goal: Floats,
    near: Floats,
    chance: np.random.Generator,
    restarts: int = RESTARTS,
) -> Floats:
    """Return joint positions that bring the hand to a pose without touching anything.

    Args:
        arm: the arm.
        surroundings: what it must not touch.
        goal: X_BT, the pose of the tip in the base's frame: (4, 4).
        near: (joints,) rad, where the search begins; then it begins at random positions.
        chance: source of these.
        restarts: maximum number of beginnings.

    Raises:
        Unreachable: no such positions were found; the text says why.
    """
    blocked: Floats | None = None
    begin = near
    for _ in range(restarts):
        positions = arm.descend(goal, begin)
        if positions is not None:
            if not surroundings.collides(positions):
                return positions
            blocked = positions
        begin = arm.random(chance)
    x, y, z = goal[:3, 3]
    place = f"({x:.3f}, {y:.3f}, {z:.3f})"
    if blocked is None:
        raise Unreachable(f"the arm cannot bring its hand to {place} with this direction")
    first, second = surroundings.touching(blocked)[0]
    raise Unreachable(f"at {place} the arm would touch something: {first} and {second}")


@dataclass(frozen=True)
class PlannerSettings:
    """How ways are searched.

    Attributes:
        step_rad: greatest change of a joint in a step of the trees.
        max_steps: number of random positions after which the search is given up.
        shortcuts: number of random shortcuts that smooth a way.
    """

    step_rad: float = 0.3
    max_steps: int = 4000
    shortcuts: int = 60


class _Tree:
    """Positions, each with the one from which it was reached."""

    def __init__(self, root: Floats, size: int) -> None:
        self.positions = np.empty((size, len(root)))
        self.parents = np.empty(size, np.intp)
        self.positions[0], self.parents[0] = root, -1
        self.count = 1

    def nearest(self, position: Floats) -> int:
        return int(((self.positions[: self.count] - position) ** 2).sum(axis=1).argmin())

    def add(self, position: Floats, parent: int) -> int:
        self.positions[self.count], self.parents[self.count] = position, parent
        self.count += 1
        return self.count - 1

    def way(self, place: int) -> list[Floats]:
        """Return the positions from the root to this one."""
        way = []
        while place >= 0:
            way.append(self.positions[place].copy())
            place = int(self.parents[place])
        return way[::-1]


def plan(
    surroundings: CollisionWorld,
    begin: Floats,
    end: Floats,
    chance: np.random.Generator,
    settings: PlannerSettings | None = None,
) -> Floats:
    """Return a way without collisions between two positions: (N, joints), rad.

    By RRT-Connect: two trees grow towards random positions and each other (Kuffner and LaValle,
    "RRT-Connect: An efficient approach to single-query path planning", ICRA 2000). Then random shortcuts
    smooth the way.

    Args:
        surroundings: what the arm must not touch.
        begin: (joints,) rad.
        end: (joints,) rad.
        chance: source of the random positions.
        settings: how to search.

    Raises:
        Unreachable: the arm touches something at one of the ends.
        NoWay: no way was found.
    """
    settings = settings or PlannerSettings()
    for name, position in (("where it is", begin), ("where it should be", end)):
        if surroundings.collides(position):
            first, second = (surroundings.touching(position) or [("the arm", "something")])[0]
            raise Unreachable(f"the arm touches something {name}: {first} and {second}")
    if surroundings.is_free(begin, end, CHECK_RAD):
        return np.array([begin, end])
    trees = [_Tree(begin, 2 * settings.max_steps + 2), _Tree(end, 2 * settings.max_steps + 2)]
    for turn in range(settings.max_steps):
        grown, other = trees if turn % 2 == 0 else trees[::-1]
        if max(grown.count, other.count) >= 2 * settings.max_steps:
            break
        place = _extend(surroundings, grown, surroundings.arm.random(chance), settings.step_rad)
        if place is None:
            continue
        met = _connect(surroundings, other, grown.positions[place], settings)
        if met is not None:
            ways = [grown.way(place), other.way(met)]
            there, back = ways if turn % 2 == 0 else ways[::-1]
            return _smoothed(surroundings, np.array(there + back[::-1][1:]), chance, settings.shortcuts)
    raise NoWay(f"found no way for the arm in {settings.max_steps} steps")


def _extend(surroundings: CollisionWorld, tree: _Tree, target: Floats, step_rad: float) -> int | None:
    """Grow a tree one step towards a position; return the new place, or None if something is in the way."""
    nearest = tree.nearest(target)
    there = tree.positions[nearest]
    away = target - there
    longest = float(np.abs(away).max())
    step = target if longest <= step_rad else there + away * (step_rad / longest)
    return tree.add(step, nearest) if surroundings.is_free(there, step, CHECK_RAD) else None


def _connect(
    surroundings: CollisionWorld, tree: _Tree, target: Floats, settings: PlannerSettings
) -> int | None:
    """Grow a tree to a position as far as it goes; return the place if it arrives."""
    while tree.count < 2 * settings.max_steps:
        place = _extend(surroundings, tree, target, settings.step_rad)
        if place is None:
            return None
        if np.array_equal(tree.positions[place], target):
            return place
    return None


def _smoothed(surroundings: CollisionWorld, way: Floats, chance: np.random.Generator, tries: int) -> Floats:
    """Return a shorter way: random pieces are replaced by straight ones where nothing is in the way."""
    for _ in range(tries):
        if len(way) < 3:
            break
        lengths = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(way, axis=0)).max(axis=1))])
        first_m, second_m = np.sort(chance.uniform(0.0, lengths[-1], 2))
        first, second = (_at(way, lengths, length) for length in (first_m, second_m))
        after = int(np.searchsorted(lengths, first_m, side="right"))
        before = int(np.searchsorted(lengths, second_m, side="left"))
        if before <= after - 1 or not surroundings.is_free(first, second, CHECK_RAD):
            continue
        way = np.concatenate([way[:after], [first, second], way[before:]])
        keep = np.concatenate([[True], np.abs(np.diff(way, axis=0)).max(axis=1) > 1e-9])
        way = way[keep]
    return way


def _at(way: Floats, lengths: Floats, length: float) -> Floats:
    return np.array([np.interp(length, lengths, way[:, joint]) for joint in range(way.shape[1])])


def straight_line(
    arm: ArmModel,
    surroundings: CollisionWorld,
    begin: Floats,
    goal: Floats,
    half_opening_m: float | None = None,
) -> Floats:
    """Return a way on which the hand moves straight to a pose: (N, joints), rad.

    Args:
        arm: the arm.
        surroundings: what it must not touch.
        begin: (joints,) rad.
        goal: X_BT, the pose at its end: (4, 4).
        half_opening_m: half of the gripper's opening; None: open.

    Raises:
        Unreachable: the arm cannot follow the line, or touches something; the text says where.
    """
    pose = arm.pose(begin)
    turn = Rotation.from_matrix(np.array([pose[:3, :3], goal[:3, :3]]))
    turn_rad = float((turn[0].inv() * turn[1]).magnitude())
    length_m = float(np.linalg.norm(goal[:3, 3] - pose[:3, 3]))
    count = max(1, math.ceil(length_m / LINE_STEP_M), math.ceil(turn_rad / LINE_STEP_RAD))
    between = Slerp([0.0, 1.0], turn)
    way = [np.asarray(begin)]
    for share in np.arange(1, count + 1) / count:
        step = np.eye(4)
        step[:3, :3] = between(share).as_matrix()
        step[:3, 3] = pose[:3, 3] + share * (goal[:3, 3] - pose[:3, 3])
        positions = arm.descend(step, way[-1])
        if positions is None or np.abs(positions - way[-1]).max() > JUMP_RAD:
            raise Unreachable(f"the hand cannot go on in a straight line after {share * length_m:.3f} m")
        if surroundings.collides(positions, half_opening_m):
            first, second = (surroundings.touching(positions) or [("the arm", "something")])[0]
            raise Unreachable(
                f"on its straight line, the arm touches something after {share * length_m:.3f} m: "
                f"{first} and {second}"
            )
        way.append(positions)
    return np.array(way)
