"""A simulated differential drive in an arena; it owns the robot's true pose."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.drive import Drive, DriveState, capped_validity_s
from robbie_robots.hw.pose import ORIGIN, Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.changing_arena import ChangingArena
from robbie_robots.hw.simulation.differential_drive import DifferentialDrive
from robbie_robots.hw.simulation.doors import Doors
from robbie_robots.hw.simulation.people import leg_circles
from robbie_robots.hw.simulation.wheel import SimulatedWheel, WheelErrors

STEP_S = 0.01
# A contact ends when the robot is this far away.
RELEASE_M = 0.01


@dataclass(frozen=True)
class WorldState:
    """The state of the simulated world that must survive a restart of its process.

    Attributes:
        true_pose: the robot's true pose, arena frame.
        odometry: the pose by wheel odometry, odometry frame.
        collisions: number of collisions.
        expired_commands: number of stops because no newer command arrived.
        emergency_stopped: whether the emergency stop is engaged.
        elapsed_s: simulated time.
        obstacles: indices of the temporary obstacles that are present.
        people: where people are on their ways, as `robbie_robots.hw.simulation.people.PersonState`.
        touches: number of times that the robot drove against a person; each is a collision, too.
        doors: how far doors are open, as `robbie_robots.hw.simulation.doors.Doors.states`.
    """

    true_pose: Pose
    odometry: Pose = ORIGIN
    collisions: int = 0
    expired_commands: int = 0
    emergency_stopped: bool = False
    elapsed_s: float = 0.0
    obstacles: tuple[int, ...] = ()
    people: tuple[tuple[float, ...], ...] = ()
    touches: int = 0
    doors: tuple[tuple[float, float], ...] = ()


class SimulatedDrive(Drive):
    """Moves a robot through an arena, driven by a clock.

    Each call advances the motion in fixed steps up to the clock's time, so the result does not depend on how
    often you call it. A new drive starts at rest.

    Args:
        arena: the world; its walls stop the robot.
        clock: returns the time in s; it must not go back.
        seed: random seed of the wheels' slip; the same seed and commands give the same odometry.
        body: geometry and limits.
        errors: the wheels' systematic and random errors.
        resumed: the state left by an earlier drive; by default the robot is at the arena's start.
        others: returns x and y (m) of the other robots in the arena, `(N, 2)`; they stop this robot.
    """

    def __init__(
        self,
        arena: Arena,
        clock: Callable[[], float],
        seed: int = 0,
        body: DifferentialDrive | None = None,
        errors: WheelErrors | None = None,
        resumed: WorldState | None = None,
        others: Callable[[], NDArray[np.float64]] | None = None,
    ) -> None:
        self._clock = clock
        self._find_others = others
        self._others = np.empty((0, 2))
        self._body = body or DifferentialDrive()
        errors = errors or WheelErrors()
        world = resumed or WorldState(arena.start)
        self._true_pose = world.true_pose
        self._odometry = world.odometry
        self.collisions = world.collisions
        self.expired_commands = world.expired_commands
        self._emergency_stopped = world.emergency_stopped
        self.touches = world.touches
        radius_m = self._body.body_radius_m
        self._surroundings = ChangingArena(arena, radius_m, world.obstacles, world.people, world.doors)
        tick_m, slip = self._body.tick_m, errors.slip_m_per_sqrt_m
        self._left = SimulatedWheel(tick_m, errors.left_scale, slip, (seed, 0))
        self._right = SimulatedWheel(tick_m, errors.right_scale, slip, (seed, 1))
        self.ticks = (0, 0)
        """The counts of the encoders of the left and the right wheel since this drive began."""
        self._time_s = clock()
        self._began_s = self._time_s - world.elapsed_s
        self._speeds = (0.0, 0.0)
        self._wanted = (0.0, 0.0)
        self._expires_s = self._time_s
        self._has_expired = False
        self._touching = False

    def command(self, linear_m_per_s: float, angular_rad_per_s: float, valid_for_s: float) -> None:
        """Follow the command, within the limits, until it expires."""
        valid_for_s = capped_validity_s(linear_m_per_s, angular_rad_per_s, valid_for_s)
        self._advance()
        if not self._emergency_stopped:
            self._wanted = self._body.limited(linear_m_per_s, angular_rad_per_s)
            self._expires_s = self._time_s + valid_for_s
            self._has_expired = False

    def read(self) -> DriveState:
        """Return the robot's state by wheel odometry (odometry frame)."""
        self._advance()
        return DriveState(self._time_s, self._odometry, *self._speeds)

    def stop(self) -> None:
        """Brake to a halt."""
        self._advance()
        self._wanted = (0.0, 0.0)

    def stop_for_emergency(self) -> None:
        """Brake as hard as possible, and do not move again before `release`."""
        self.stop()
        self._emergency_stopped = True

    def release(self) -> None:
        """End the emergency stop; the drive stands until the next command."""
        self._advance()
        self._emergency_stopped = False

    @property
    def is_emergency_stopped(self) -> bool:
        """Return whether the emergency stop is engaged."""
        return self._emergency_stopped

    @property
    def obstacles(self) -> tuple[int, ...]:
        """Return the indices of the arena's temporary obstacles that are present."""
        return self._surroundings.obstacles

    @property
    def people(self) -> NDArray[np.float64]:
        """Return where people are: (P, 5), as `robbie_robots.hw.simulation.people.PersonState.shown`."""
        return self._surroundings.people.shown

    @property
    def doors(self) -> Doors:
        """Return the arena's doors."""
        return self._surroundings.doors

    def ground_truth(self) -> DriveState:
        """Return the robot's true state (arena frame)."""
        self._advance()
        return DriveState(self._time_s, self._true_pose, *self._speeds)

    def world_state(self) -> WorldState:
        """Return the state from which a drive in a new process can continue."""
        self._advance()
        return WorldState(
            self._true_pose,
            self._odometry,
            self.collisions,
            self.expired_commands,
            self._emergency_stopped,
            self._time_s - self._began_s,
            self.obstacles,
            tuple(tuple(state) for state in self._surroundings.people.states),
            self.touches,
            self.doors.states,
        )

    def _advance(self) -> None:
        now_s = self._clock()
        if self._find_others is not None:
            self._others = self._find_others()
        while self._time_s + STEP_S <= now_s:
            self._expire()
            if self._wanted == (0.0, 0.0) == self._speeds:
                self._time_s = now_s  # the robot does not move until the next command
            else:
                self._step()
                self._time_s += STEP_S
            self._surroundings.change(self._time_s - self._began_s, self._true_pose)

    def _expire(self) -> None:
        if self._time_s >= self._expires_s and self._wanted != (0.0, 0.0):
            self._wanted = (0.0, 0.0)
            self._has_expired = True
            self.expired_commands += 1

    def _step(self) -> None:
        if self._emergency_stopped or self._has_expired:
            self._speeds = self._body.braked(self._speeds, STEP_S)
        else:
            self._speeds = self._body.approached(self._speeds, self._wanted, STEP_S)
        way_m, turn_rad = self._speeds[0] * STEP_S, self._speeds[1] * STEP_S
        if way_m and not self._passes(self._true_pose.after_arc(way_m, turn_rad)):
            way_m = 0.0
            self._speeds = (0.0, self._speeds[1])
        self._true_pose = self._true_pose.after_arc(way_m, turn_rad)
        half_m = turn_rad * self._body.axle_m / 2
        left, right = self._left.roll(way_m - half_m), self._right.roll(way_m + half_m)
        self.ticks = (self.ticks[0] + left, self.ticks[1] + right)
        self._odometry = self._body.after_ticks(self._odometry, left, right)

    def _passes(self, there: Pose) -> bool:
        """Return whether the robot can go there; count the start of a contact."""
        positions = np.array([self._true_pose[:2], there[:2]])
        around = self._surroundings.arena.with_robots(self._others, self._body.body_radius_m)
        legs = leg_circles(self.people)
        before_m, after_m = around.with_circles(legs).clearance_m(positions)
        if after_m >= self._body.body_radius_m or after_m > before_m:
            self._touching = self._touching and after_m < self._body.body_radius_m + RELEASE_M
            return True
        if not self._touching:
            self.collisions += 1
            to_legs_m = np.hypot(*(legs[:, :2] - positions[1]).T) - legs[:, 2]
            self.touches += bool(to_legs_m.min(initial=np.inf) < self._body.body_radius_m)
        self._touching = True
        return False
