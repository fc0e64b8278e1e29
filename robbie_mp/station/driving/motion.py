"""The robot's commanded and true motion, and the reason if it stands although it is commanded."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robbie_mp.messages import (
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
    silent: str = ""
    """For how long the odometry has been silent; '' while it is not."""
    hint: str = ""
    """Why the robot does not move although it is commanded, or that it drives without guard; '' otherwise."""


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
        self._ahead: tuple[list[LaserScan], float | None] = ([], None)
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
        pitch, roll = tilt(self._imu.message.orientation) if self._imu.message else (None, None)
        found = Movement(
            linear_m_per_s=twist.linear.x if twist else None,
            angular_rad_per_s=twist.angular.z if twist else None,
            commanded_linear=linear,
            commanded_angular=angular,
            heading_rad=self._heading(),
            pitch_rad=pitch,
            roll_rad=roll,
            ahead_m=self._ahead_m(now_s),
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

    def _ahead_m(self, now_s: float) -> float | None:
        scans = [scan for put_s, scan in list(self._scans.values()) if now_s - put_s <= SILENT_AFTER_S]
        known = self._ahead[0]
        if len(scans) != len(known) or any(a is not b for a, b in zip(scans, known, strict=True)):
            self._ahead = (scans, self._nearest_m(scans))
        return self._ahead[1]

    def _nearest_m(self, scans: list[LaserScan]) -> float | None:
        """Return the free way ahead in the scans of all lasers whose places are known; None if none is."""
        points: list[NDArray[np.float64]] = []
        farthest_m = 0.0
        for scan in scans:
            try:
                pose = self._graph.pose(BASE, scan.header.frame_id)
            except SceneGraphError:
                continue
            points.append(pose.apply(scan_points(scan).places))
            farthest_m = max(farthest_m, scan.range_max)
        if not points:
            return None
        length_m, width_m, _ = self._size_m
        return free_way_m(np.concatenate(points), length_m, width_m, farthest_m)

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


def heading_deg(yaw_rad: float) -> int:
    """Return a heading as all panels show it, 0 to 359°.

    Counter-clockwise from the map's x axis: right on the map with north up.
    """
    return round(math.degrees(yaw_rad)) % 360


def tilt(q: Quaternion) -> tuple[float, float]:
    """Return pitch and roll of an orientation, rad: pitch is positive with the front down."""
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (q.w * q.y - q.z * q.x))))
    return pitch, math.atan2(2.0 * (q.w * q.x + q.y * q.z), 1.0 - 2.0 * (q.x * q.x + q.y * q.y))
