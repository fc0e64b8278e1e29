"""A simulated robot that drives to goals, in simulated time: arena, laser, drive and navigator."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.hw.simulation.random_rooms import drawn_map
from robbie_robots.workers.navigation.collision_guard import CollisionGuard
from robbie_robots.workers.navigation.navigator import Navigator
from robbie_robots.workers.navigation.navigator_states import RESTING, NavigatorSettings
from tests._support.places import ARENAS
from tools.trials.driving.swept import swept

DEMO = ARENAS / "demo.yaml"
RESOLUTION_M = 0.05
LATENCY_S = 0.05
BODY_M = 0.2


def demo_arena() -> Arena:
    return read_arena(DEMO)


class NavigationWorld:
    """A robot in an arena, with the map of `mapped`; a step is a sweep and a command, 0.1 s."""

    def __init__(
        self, mapped: Arena, arena: Arena | None = None, settings: NavigatorSettings | None = None
    ) -> None:
        self.now_s = 0.0
        arena = arena or mapped
        self.arena, self.others = arena, np.empty((0, 2))
        self.drive = SimulatedDrive(arena, lambda: self.now_s, seed=1, others=lambda: self.others)
        self.laser = SimulatedLaser(arena, seed=1)
        self.laser_works = self.pose_works = True
        self.navigator = Navigator(lambda: self.now_s, CollisionGuard(), settings=settings)
        self.cells, self.corner = drawn_map(mapped, RESOLUTION_M)
        self.navigator.see_map(self.cells, RESOLUTION_M, self.corner)
        self.states: list[str] = []

    def meet(self, places: NDArray[np.float64]) -> None:
        """Put other robots at places `(N, 2)`, m; they are not on the map."""
        self.others = places
        self.laser.arena = self.arena.with_robots(places, BODY_M)

    def run(self, limit_s: float) -> None:
        """Go on until the navigator rests."""
        end_s = self.now_s + limit_s
        while self.now_s < end_s - 1e-9:
            self._step()
            if self.navigator.state in RESTING:
                break

    def _step(self) -> None:
        truth = self.drive.ground_truth()
        if self.pose_works:
            self.navigator.see_pose(truth.pose, truth.stamp_s, self.now_s)
        if self.laser_works:
            self.laser.place(truth.pose, truth.stamp_s)
            self.navigator.see_sweep(swept(self.laser), truth.stamp_s, self.now_s)
        self.now_s += LATENCY_S
        speeds = self.navigator.drive()
        if speeds is not None:
            self.drive.command(*speeds, valid_for_s=0.4)
        self.now_s += 0.1 - LATENCY_S
        if not self.states or self.states[-1] != self.navigator.state.name:
            self.states.append(self.navigator.state.name)

    def off_m(self, goal: Sequence[float]) -> float:
        return float(np.hypot(*(np.array(self.drive.ground_truth().pose[:2]) - goal[:2])))
