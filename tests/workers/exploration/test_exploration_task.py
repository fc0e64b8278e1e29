"""The exploration task, with fresh and outdated inputs, and when recoveries fail."""

from typing import Any

import numpy as np
import pytest

from robbie_robots.workers.exploration.explorer import Explorer
from robbie_robots.workers.exploration.explorer_states import ExplorerSettings, ExplorerState
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from robbie_robots.workers.navigation.collision_guard import CollisionGuard
from robbie_robots.workers.navigation.path_follower import HALT
from tests._support.present import present
from tests.workers._support.exploration_world import RESOLUTION_M, drawn_cells

BEAMS = (-np.pi, np.pi / 180, 0.05, 10.0)
FREE = LaserSweep.from_ranges(np.full(360, np.inf), *BEAMS)
HALF_KNOWN = """
################
#.............
#.............
#.............
#.............
#.............
################
"""
KNOWN = HALF_KNOWN.replace(".\n", ".##\n").strip("\n")


class Clock:
    now_s = 50.0

    def __call__(self) -> float:
        return self.now_s


class World:
    """An explorer in a world that only the test moves."""

    def __init__(
        self,
        drawing: str,
        pose: tuple[float, float, float] = (1.0, 0.9, 0.0),
        sweep: LaserSweep = FREE,
        **settings: Any,
    ) -> None:
        self.clock = Clock()
        self.pose, self.sweep = pose, sweep
        self.explorer = Explorer(self.clock, CollisionGuard(), ExplorerSettings(**settings))
        self.show(drawing)

    def show(self, drawing: str) -> None:
        self.explorer.see_map(drawn_cells(drawing), RESOLUTION_M, (0.0, 0.0))

    def tick(self, seconds: float = 0.1) -> list[tuple[float, float]]:
        """Let time pass at 10 Hz with fresh inputs; return the commands."""
        commands = []
        for _ in range(max(1, round(seconds * 10))):
            self.clock.now_s += 0.1
            self.explorer.see_pose(self.pose, self.clock.now_s, self.clock.now_s)
            self.explorer.see_sweep(self.sweep, self.clock.now_s, self.clock.now_s)
            commands.append(self.explorer.drive())
        return commands

    def state(self) -> ExplorerState:
        return self.explorer.state


def drawn_rectangle(drawing: str) -> str:
    lines = drawing.strip("\n").splitlines()
    width = max(map(len, lines))
    return "\n".join(line.ljust(width) for line in lines)


HALF_KNOWN, KNOWN = drawn_rectangle(HALF_KNOWN), drawn_rectangle(KNOWN)


def test_explorer_waits_for_map_pose_and_laser() -> None:
    clock = Clock()
    explorer = Explorer(clock, CollisionGuard())
    assert explorer.drive() == HALT
    explorer.see_pose((1, 1, 0), clock(), clock())
    explorer.see_sweep(FREE, clock(), clock())
    assert explorer.drive() == HALT
    waiting = explorer.state
    explorer.see_map(drawn_cells(HALF_KNOWN), RESOLUTION_M, (0, 0))
    explorer.drive()
    assert (waiting, explorer.state) == (ExplorerState.WAIT, ExplorerState.EXPLORE)


def test_explorer_drives_to_the_frontier() -> None:
    world = World(HALF_KNOWN)
    linear, angular = world.tick()[-1]
    assert linear > 0.2
    assert abs(angular) < 0.5
    assert present(world.explorer.plan.goal_xy_m)[0] > 3.0


@pytest.mark.parametrize("stale", ["see_pose", "see_sweep"])
def test_explorer_stops_when_an_input_is_too_old_and_continues_when_it_is_back(
    stale: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = World(HALF_KNOWN)
    assert world.tick()[-1] != HALT
    with monkeypatch.context() as patch:
        patch.setattr(world.explorer, stale, lambda *_: None)
        assert world.tick(1.0)[-1] == HALT
        assert world.state() is ExplorerState.WAIT
    assert world.tick()[-1] != HALT
    assert world.state() is ExplorerState.EXPLORE


def test_exploration_ends_only_when_two_maps_have_no_frontier() -> None:
    world = World(KNOWN)
    world.tick()
    assert world.state() is ExplorerState.EXPLORE
    world.tick(1.0)
    assert world.state() in (ExplorerState.RETURN, ExplorerState.DONE)


def test_explorer_ends_at_home() -> None:
    world = World(KNOWN)
    assert world.tick(3.0)[-1] == HALT
    assert world.state() is ExplorerState.DONE
    assert "home" in world.explorer.status


def test_explorer_drives_home_from_far() -> None:
    world = World(HALF_KNOWN)
    world.tick()
    world.pose = (3.0, 0.9, np.pi)
    world.show(KNOWN)
    assert world.tick(1.5)[-1][0] > 0.2
    assert world.state() is ExplorerState.RETURN
    world.pose = (1.0, 0.9, np.pi)
    world.tick(1.0)
    assert world.state() is ExplorerState.DONE


def test_explorer_that_does_not_return_ends_where_it_is() -> None:
    world = World(KNOWN, returns_home=False)
    world.tick(1.5)
    assert world.state() is ExplorerState.DONE


def test_time_limit_ends_exploring() -> None:
    world = World(HALF_KNOWN, time_limit_s=2.0, returns_home=False)
    world.tick(1.5)
    assert world.state() is ExplorerState.EXPLORE
    world.tick(1.5)
    assert world.state() is ExplorerState.DONE
    assert "time" in world.explorer.machine.reason


def test_goal_without_progress_is_given_up_and_the_task_still_ends() -> None:
    world = World(HALF_KNOWN)  # the robot obeys in vain: its pose never changes
    world.tick(30.0)
    assert world.state() is ExplorerState.DONE
    assert "1 goals given up" in world.explorer.status


def test_blocked_robot_backs_up_and_tries_again() -> None:
    ahead = np.full(360, np.inf)
    ahead[170:190] = 0.26
    world = World(HALF_KNOWN, sweep=LaserSweep.from_ranges(ahead, *BEAMS))
    commands = world.tick(1.6)
    assert world.state() is ExplorerState.RECOVER
    assert max(linear for linear, _ in commands) == 0.0
    assert world.tick(0.5)[-1][0] < 0.0
    world.sweep = FREE
    world.tick(2.0)
    assert world.state() is ExplorerState.EXPLORE


def test_enclosed_robot_turns_but_never_drives_and_ends() -> None:
    world = World(HALF_KNOWN, sweep=LaserSweep.from_ranges(np.full(360, 0.24), *BEAMS))
    commands = np.array(world.tick(60.0))
    assert not commands[:, 0].any()
    assert world.state() is ExplorerState.DONE
    assert "stuck" in present(world.explorer.exploring_ended)


def test_robot_outside_of_its_map_ends_in_state_stuck() -> None:
    world = World(HALF_KNOWN, pose=(-5.0, -5.0, 0.0))
    world.tick(60.0)
    assert world.state() is ExplorerState.DONE
    assert "stuck" in world.explorer.machine.reason


def test_finished_task_stays_finished() -> None:
    world = World(KNOWN, returns_home=False)
    world.tick(2.0)
    world.show(HALF_KNOWN)
    assert set(world.tick(2.0)) == {HALT}


def test_restarted_explorer_knows_its_home() -> None:
    clock = Clock()
    explorer = Explorer(clock, CollisionGuard(), home_xy_m=(1.0, 2.0))
    explorer.see_pose((3.0, 3.0, 0.0), clock(), clock())
    assert present(explorer.home_xy_m).tolist() == [1.0, 2.0]
