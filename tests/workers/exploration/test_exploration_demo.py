"""The closed loop in one process: arena, laser, map, exploration and drive, in simulated time."""

import numpy as np
import pytest
from scipy import ndimage

from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.workers.exploration.explorer import Explorer
from robbie_robots.workers.exploration.explorer_states import ExplorerState
from robbie_robots.workers.navigation.collision_guard import CollisionGuard
from tests._support.places import ARENAS
from tests._support.present import present
from tests.workers._support.exploration_world import RESOLUTION_M, TruePoseMap
from tools.trials.driving.swept import swept

pytestmark = pytest.mark.slow

DEMO = ARENAS / "demo.yaml"
LATENCY_S = 0.05


class Loop:
    """One robot in the demo arena; a step is a sweep and a command, 0.1 s."""

    def __init__(self, seed: int) -> None:
        self.now_s = 0.0
        self.arena = read_arena(DEMO)
        self.drive = SimulatedDrive(self.arena, lambda: self.now_s, seed)
        self.laser = SimulatedLaser(self.arena, seed=seed)
        self.angles = self.laser.geometry.angles_rad()
        self.map = TruePoseMap(self.arena.width_m, self.arena.height_m)
        self.explorer = Explorer(lambda: self.now_s, CollisionGuard())
        self.explored_s: float | None = None

    def run(self, limit_s: float) -> None:
        step = 0
        while self.explorer.state is not ExplorerState.DONE and self.now_s < limit_s:
            self._step(shows_map=step % 5 == 0)
            step += 1
            self.now_s = step * 0.1
            if self.explored_s is None and self.explorer.state is ExplorerState.RETURN:
                self.explored_s = self.now_s

    def _step(self, shows_map: bool) -> None:
        truth = self.drive.ground_truth()
        self.laser.place(truth.pose, truth.stamp_s)
        sweep = swept(self.laser)
        self.map.add(truth.pose, sweep.ranges_m, self.angles)
        if shows_map:
            self.explorer.see_map(self.map.cells, RESOLUTION_M, self.map.corner_xy_m)
        self.explorer.see_pose(truth.pose, truth.stamp_s, truth.stamp_s)
        self.explorer.see_sweep(sweep, truth.stamp_s, truth.stamp_s)
        self.now_s += LATENCY_S
        self.drive.command(*self.explorer.drive(), valid_for_s=0.4)


def reachable(arena: Arena, map_: TruePoseMap) -> np.ndarray:
    """Cells of the map that are connected to the start without crossing a wall."""
    rows, columns = np.mgrid[: map_.cells.shape[0], : map_.cells.shape[1]]
    middles = (np.stack([columns, rows], axis=-1) + 0.5) * RESOLUTION_M + map_.corner_xy_m
    regions, _ = ndimage.label(arena.clearance_m(middles) > 0.04)
    column, row = ((np.array(arena.start[:2]) - map_.corner_xy_m) / RESOLUTION_M).astype(int)
    return np.asarray(regions == regions[row, column])


def test_demo_arena_is_explored_in_time_without_touching_a_wall() -> None:
    loop = Loop(seed=1)
    loop.run(limit_s=60.0)
    place = reachable(loop.arena, loop.map)
    assert loop.explorer.state is ExplorerState.DONE, loop.explorer.status
    assert loop.drive.collisions == 0
    assert present(loop.explored_s) < 45.0
    assert (loop.map.cells[place] >= 0).mean() > 0.95
    home = loop.drive.ground_truth().pose
    assert np.hypot(*(np.array(home[:2]) - loop.arena.start[:2])) < 0.25


def test_robot_stops_when_the_explorer_dies_while_driving() -> None:
    loop = Loop(seed=2)
    loop.run(limit_s=2.0)
    assert loop.drive.read().linear_m_per_s > 0.1
    loop.now_s += 3.0  # nobody commands any more
    assert loop.drive.read().linear_m_per_s == 0.0
    assert (loop.drive.expired_commands, loop.drive.collisions) == (1, 0)
