"""The robot's commanded and true motion, and the reason if it stands although it is commanded."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages import (
    Bumper,
    ControlState,
    DriveCommand,
    EmergencyStop,
    Imu,
    LaserScan,
    Odometry,
    Quaternion,
)
from robbie_mp.scene import SceneGraphError
from robbie_mp.station.scene_view.points import scan_points
from robbie_mp.station.watch.latest import MessageSource, silence

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence, Sized

    from robbie_mp.scene import SceneGraphListener

BASE = "base_link"
PERIOD_S = 0.1
SILENT_AFTER_S = 1.0
"""Maximum time between two odometry messages of a working base."""
FRESH_S = 0.5
"""A command is shown for this time."""
STANDS_AFTER_S = 1.0
"""A robot that has not moved for this time although it was commanded is reported."""
MOVES_M_PER_S, MOVES_RAD_PER_S = 0.02, 0.05
NEAR_M = 0.15
WITHOUT_GUARD = "WITHOUT GUARD: nothing keeps the robot from driving into something"
DIRECTIONS = ("ahead", "ahead left", "left", "behind left", "behind", "behind right", "right", "ahead right")
"""Of the ring: each is the middle of an eighth of the circle."""
SECTOR_RAD = 2 * math.pi / len(DIRECTIONS)
MAX_PARTS = 8
"""Maximum number of pressed parts of the bumper that are shown."""
MAX_LASERS = 8
"""Scans of further ones are not looked at."""


@dataclass(frozen=True)
class Movement:
    """The robot's movement at one moment. What is not known is None."""

    linear_m_per_s: float | None = None
    angular_rad_per_s: float | None = None
    commanded_linear: float | None = None
    """m/s; None: no module and no operator commands anything now."""
    commanded_angular: float | None = None
    heading_rad: float | None = None
    pitch_rad: float | None = None
    roll_rad: float | None = None
    ahead_m: float | None = None
    """Free way ahead, from the robot's front to the nearest hit of any laser."""
    ring_m: tuple[float | None, ...] = ()
    """Free distances from the robot's edge in `DIRECTIONS`; None where no laser looks; empty without any."""
    pressed: tuple[str, ...] = ()
    """Parts of the bumper that touch something."""
    is_manual: bool = False
    """Whether an operator drives."""
    silent: str = ""
    """For how long the odometry has been silent; '' while it is not."""
    hint: str = ""
    """Why the robot does not move although it is commanded, or that it drives without guard; '' otherwise."""


@dataclass(frozen=True)
class Surroundings:
    """What the lasers see round the robot."""

    ahead_m: float | None = None
    ring_m: tuple[float | None, ...] = ()


class RobotMotion:
    """Watches the robot's movement for all pages. Used in the station's thread, but for `command`.

    Args:
        messages: source of the messages.
        scene: where the robot and its lasers are.
        pages: the open pages; without any, it does not look.
        robot_size_m: length, width and height of the robot.
        now_s: the clock of ages.

    Attributes:
        now: the movement at present.
    """

    def __init__(
        self,
        messages: MessageSource,
        scene: SceneGraphListener,
        pages: Sized,
        robot_size_m: Sequence[float],
        now_s: Callable[[], float] = time.monotonic,
    ):
        self._now_s = now_s
        self._graph = scene.graph
        self._pages = pages
        self._size_m = robot_size_m
        self._odometry = messages.newest(Odometry, "odom")
        self._imu = messages.newest(Imu)
        self._scans: dict[str, tuple[float, LaserScan]] = {}
        messages.newest(LaserScan).listen(self.scan)
        self._stop = messages.newest(EmergencyStop, "emergency_stop_state")
        self._control = messages.newest(ControlState, "control")
        self._commands = messages.newest(DriveCommand)
        self._commands.listen(self.command)
        self._command: tuple[float, DriveCommand] | None = None
        self._stands_since_s: float | None = None
        self._next_s = 0.0
        self._bumper = messages.newest(Bumper)
        self._around: tuple[list[LaserScan], Surroundings] = ([], Surroundings())
        self.now = Movement()

    def scan(self, scan: LaserScan) -> None:
        """Note the newest scan of each laser, by its frame; any thread may call this."""
        frame = scan.header.frame_id
        if frame in self._scans or len(self._scans) < MAX_LASERS:
            self._scans[frame] = (self._now_s(), scan)

    def command(self, command: DriveCommand) -> None:
        """Note a command; any thread may call this."""
        self._command = (self._now_s(), command)

    def tick(self) -> None:
        """Look at the movement, while any page is open."""
        now_s = time.monotonic()
        if not self._pages or now_s < self._next_s:
            return
        self._next_s = now_s + PERIOD_S
        self.now = self._look(self._now_s())

    def _look(self, now_s: float) -> Movement:
        odometry = self._odometry.message
        twist = odometry.twist.twist if odometry else None
        given = self._command
        command = given[1] if given and now_s - given[0] < FRESH_S else None
        linear = command.linear_m_per_s if command else None
        angular = command.angular_rad_per_s if command else None
        around, bumper, control = self._look_around(now_s), self._bumper.message, self._control.message
        pitch, roll = tilt(self._imu.message.orientation) if self._imu.message else (None, None)
        found = Movement(
            linear_m_per_s=twist.linear.x if twist else None,
            angular_rad_per_s=twist.angular.z if twist else None,
            commanded_linear=linear,
            commanded_angular=angular,
            heading_rad=self._heading(),
            pitch_rad=pitch,
            roll_rad=roll,
            ahead_m=around.ahead_m,
            ring_m=around.ring_m,
            pressed=tuple(bumper.pressed[:MAX_PARTS]) if bumper is not None else (),
            is_manual=control is not None and control.mode == ControlState.MANUAL,
            silent=silence(self._odometry.age_s, SILENT_AFTER_S),
            hint=WITHOUT_GUARD if command is not None and command.unguarded else "",
        )
        return replace(found, hint=self._why(found)) if self._stands(found, now_s) else found

    def _heading(self) -> float | None:
        try:
            return self._graph.pose("map", BASE).yaw
        except SceneGraphError:
            odometry = self._odometry.message
            return odometry.pose.pose.orientation.yaw if odometry else None

    def _look_around(self, now_s: float) -> Surroundings:
        scans = [scan for put_s, scan in list(self._scans.values()) if now_s - put_s <= SILENT_AFTER_S]
        known = self._around[0]
        if len(scans) != len(known) or any(a is not b for a, b in zip(scans, known, strict=True)):
            self._around = (scans, self._seen_by(scans))
        return self._around[1]

    def _seen_by(self, scans: list[LaserScan]) -> Surroundings:
        """Return what is around by the scans of all lasers whose places are known."""
        points: list[NDArray[np.float64]] = []
        looks: list[NDArray[np.float64]] = []
        farthest_m = 0.0
        for scan in scans:
            try:
                pose = self._graph.pose(BASE, scan.header.frame_id)
            except SceneGraphError:
                continue
            points.append(pose.apply(scan_points(scan).places))
            ranges = np.asarray(scan.ranges, np.float64)
            rays = np.flatnonzero(ranges >= scan.range_min).astype(np.float64)  # others have measured nothing
            looks.append(np.asarray(pose.yaw + scan.angle_min + scan.angle_increment * rays, np.float64))
            farthest_m = max(farthest_m, scan.range_max)
        if not points:
            return Surroundings()
        length_m, width_m, _ = self._size_m
        hits = np.concatenate(points)
        ring_m = ring_of(hits, np.concatenate(looks), length_m, width_m, farthest_m)
        return Surroundings(free_way_m(hits, length_m, width_m, farthest_m), ring_m)

    def _stands(self, found: Movement, now_s: float) -> bool:
        """Whether the robot has not moved for some time although it is commanded."""
        wanted = max(
            abs(found.commanded_linear or 0.0) / MOVES_M_PER_S,
            abs(found.commanded_angular or 0.0) / MOVES_RAD_PER_S,
        )
        moves = found.silent == "" and (
            abs(found.linear_m_per_s or 0.0) > MOVES_M_PER_S
            or abs(found.angular_rad_per_s or 0.0) > MOVES_RAD_PER_S
        )
        if wanted <= 1.0 or moves:
            self._stands_since_s = None
            return False
        if self._stands_since_s is None:
            self._stands_since_s = now_s
        return now_s - self._stands_since_s >= STANDS_AFTER_S

    def _why(self, found: Movement) -> str:
        if self._stop.message is not None and self._stop.message.engaged:
            return "It is commanded but stands: the emergency stop is engaged"
        control = self._control.message
        if control is not None and control.mode == ControlState.HOLD:
            return f"It is commanded but holds: {control.reason}; let go and drive again, or press Go on"
        if found.silent or found.linear_m_per_s is None:
            return "It is commanded, and the base does not report whether it moves"
        if (found.commanded_linear or 0.0) > 0 and found.ahead_m is not None and found.ahead_m < NEAR_M:
            return f"It is commanded but stands: something is {found.ahead_m:.2f} m ahead"
        command = self._command[1] if self._command else None
        if control is not None and control.mode == ControlState.MANUAL and command and not command.unguarded:
            return "It is commanded but stands: the guard stops it (Shift: without guard), or it is blocked"
        return "It is commanded but stands: it is blocked, or the base does not follow"


def free_way_m(points: NDArray[np.float64], length_m: float, width_m: float, range_max_m: float) -> float:
    """Return the free way ahead of a robot.

    Args:
        points: (N, 3) hits in base_link, m.
        length_m: length of the robot, whose middle is the origin.
        width_m: width of the robot.
        range_max_m: the way if nothing is hit.
    """
    ahead = points[(points[:, 0] > 0) & (np.abs(points[:, 1]) < width_m / 2)]
    farthest_m = range_max_m if not len(ahead) else float(ahead[:, 0].min())
    return max(0.0, farthest_m - length_m / 2)


def ring_of(
    points: NDArray[np.float64],
    looks_rad: NDArray[np.float64],
    length_m: float,
    width_m: float,
    range_max_m: float,
) -> tuple[float | None, ...]:
    """Return the free distances from a robot's edge in `DIRECTIONS`; None where no ray goes.

    Args:
        points: (N, 3) hits in base_link, m.
        looks_rad: directions of all rays in base_link.
        length_m: length of the robot, whose middle is the origin.
        width_m: width of the robot.
        range_max_m: the distance if nothing is hit.
    """
    beyond = np.abs(points[:, :2]) - np.array([length_m / 2, width_m / 2])
    distances_m = np.hypot(*np.maximum(beyond, 0.0).T)
    found: list[float | None] = [None] * len(DIRECTIONS)
    for sector in set(_sectors(looks_rad).tolist()):
        found[sector] = range_max_m
    sectors = _sectors(np.arctan2(points[:, 1], points[:, 0]))
    for sector, distance_m in zip(sectors.tolist(), distances_m.tolist(), strict=True):
        known = found[sector]
        found[sector] = distance_m if known is None else min(known, distance_m)
    return tuple(found)


def _sectors(angles_rad: NDArray[np.float64]) -> NDArray[np.int64]:
    found: NDArray[np.int64] = np.round(angles_rad / SECTOR_RAD).astype(np.int64) % len(DIRECTIONS)
    return found


def heading_deg(yaw_rad: float) -> int:
    """Return a heading as all panels show it, 0 to 359°.

    Counter-clockwise from the map's x axis: right on the map with north up.
    """
    return round(math.degrees(yaw_rad)) % 360


def tilt(q: Quaternion) -> tuple[float, float]:
    """Return pitch and roll of an orientation, rad: pitch is positive with the front down."""
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (q.w * q.y - q.z * q.x))))
    return pitch, math.atan2(2.0 * (q.w * q.x + q.y * q.z), 1.0 - 2.0 * (q.x * q.x + q.y * q.y))
