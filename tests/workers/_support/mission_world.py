"""A mission whose robot is moved by the test."""

from typing import Any

import numpy as np

from robbie_robots.workers.rescue.mission import Mission, RescueOrder
from robbie_robots.workers.rescue.mission_states import MissionSettings, MissionState
from robbie_robots.workers.rescue.mission_targets import SearchedGrid
from robbie_robots.workers.rescue.mission_victims import VictimReport
from robbie_robots.workers.rescue.searched_walls import WallFronts, WallMemory
from robbie_robots.workers.rescue.victim_map import VictimState
from tests.workers._support.exploration_world import RESOLUTION_M, drawn_cells

S = MissionState
HALL = """
################
#..............#
#..............#
#..............#
#..............#
#..............#
################
"""
HALF_KNOWN = "\n".join(line[:9] + " " * 7 for line in HALL.strip("\n").splitlines())
START = (1.0, 0.8, 0.0)


class Rescue:
    """A mission whose inputs are given by hand."""

    def __init__(self, drawing: str = HALL, **settings: Any) -> None:
        self.now_s = 100.0
        self.mission = Mission(lambda: self.now_s, MissionSettings(**settings))
        self.pose = np.array(START)
        self.cells = drawn_cells(drawing)
        self.memory = WallMemory()
        self.camera_works = True

    def state(self) -> MissionState:
        return self.mission.state

    def step(self, seconds: float = 1.0) -> RescueOrder:
        """Let time pass, with all that the robot hears in it."""
        self.now_s += seconds
        self.mission.see_pose(self.pose)
        self.mission.see_map(self.cells, RESOLUTION_M, (0.0, 0.0))
        if self.camera_works:
            self.mission.see_camera()
        grid = self.memory.grid(WallFronts(self.cells, RESOLUTION_M, (0.0, 0.0)))
        self.mission.see_searched(SearchedGrid(grid, RESOLUTION_M, (0.0, 0.0)))
        return self.mission.step()

    def begin(self) -> RescueOrder:
        self.mission.see_stopped(None)
        return self.step()

    def search_everything(self) -> None:
        fronts = WallFronts(self.cells, RESOLUTION_M, (0.0, 0.0))
        self.memory.restore({"searched": fronts.keys()})

    def tell(self, state: VictimState, x_m: float = 2.0, y_m: float = 1.4) -> None:
        report = VictimReport(4, "tag 4", x_m, y_m, 0.3, -np.pi / 2, self.now_s, 0.9, state)
        self.mission.victims.see(report)

    def drive(self, limit: int = 400) -> list[MissionState]:
        """Reach each goal at once and search what is looked at, until the mission has ended."""
        states: list[MissionState] = []
        for _ in range(limit):
            orders = self.step()
            if not states or states[-1] is not self.state():
                states.append(self.state())
            if self.mission.has_ended:
                return states
            if orders.goal is not None:
                self.pose = orders.goal
                self.cells = drawn_cells(HALL)  # there it sees the rest
                self.memory.look(WallFronts(self.cells, RESOLUTION_M, (0.0, 0.0)), self.pose, 0.7)
                self.mission.arrived()
        raise AssertionError(f"the mission has not ended: {states}")
