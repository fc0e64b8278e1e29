"""Application control of the rescue robot: explores, searches for victims, asks the operator, comes home."""

import math

import numpy as np
from numpy.typing import NDArray

from modules.planar_messages import frontiers_message, map_cells, planar, pose_stamped
from modules.rescue.messages import MissionOrder, MissionStatus, SearchedWalls, VictimFound
from robbie_mp import Header, MessageHandling, Module, Time, setting
from robbie_mp.messages import (
    BatteryState,
    CameraInfo,
    CancelGoal,
    NavigationState,
    OccupancyGrid,
    PanTiltCommand,
    PointOfInterest,
    PointsOfInterest,
    PoseStamped,
)
from workers.rescue.look_around import LookAround
from workers.rescue.mission import Mission
from workers.rescue.mission_orders import OperatorOrder
from workers.rescue.mission_states import MissionSettings, MissionState
from workers.rescue.mission_targets import SearchedGrid
from workers.rescue.mission_victims import VictimReport
from workers.rescue.rescue_report import MissionFigures, write_report
from workers.rescue.victim_map import VictimState

HOLDS = (MissionState.PAUSE, MissionState.DONE)
CANNOT_DRIVE = ("STOPPED_", "EMERGENCY_")
TELL_S = 1.0
"""Period of the mission's status while it does not change."""
REPEAT_S = 2.0
"""A goal that navigation does not report after this time is sent again."""


class RescueMission(Module):
    """Sends goals to navigation and directions to the pan-tilt unit until the mission has ended.

    With `MissionOrder`, the operator starts, pauses or aborts the mission, or calls the robot home.
    `MissionStatus` says which orders the mission accepts now, and why it refused one. The module also
    publishes the `Frontiers` that it can choose from.

    At the end, it writes the report: a map with victims and path in the style of RoboCup Rescue
    (`NAME_map.png`), the victims (`NAME_victims.csv`), and figures (`mission.json`).

    After a restart, it continues: it still knows its home, the victims, the time used, the operator's order,
    and whether it was on its way home.
    """

    period_s: float = setting(0.2, "time between decisions", minimum=0.02)
    starts_by_itself: bool = setting(True, "false: the robot waits until the operator starts the mission")
    time_limit_s: float = setting(600.0, "time by which the robot is home again", minimum=10.0)
    reserve: float = setting(
        0.15, "ratio of charge below which the battery is not used", minimum=0.0, maximum=1.0
    )
    clearance_m: float = setting(0.27, "distance of paths from obstacles; use navigation's", minimum=0.05)
    report_name: str = setting("rescue", "prefix of the names of the report's files")
    ends_after_s: float = setting(
        1.0, "time between the end of the mission and that of the module", minimum=0.0
    )

    def setup(self) -> None:
        """Create the mission; subscribe to map, pose, navigation, victims, camera and battery."""
        settings = MissionSettings(
            starts_by_itself=self.starts_by_itself,
            time_limit_s=self.time_limit_s,
            reserve=self.reserve,
            clearance_m=self.clearance_m,
        )
        self.mission = Mission(self._time_s, settings, self._state_changed)
        if self.restored is not None:
            self.mission.remember(self.restored)
        self.notes_told = len(self.mission.notes)
        self.show_state(self.mission.state)
        self.look = LookAround()
        self.pose: tuple[float, float, float] | None = None
        self.goal: NDArray[np.float64] | None = None
        self.sent_s = -math.inf
        self.judged = True
        self.is_known = False
        self.stands = self.is_cancelled = False
        self.pan_rad = math.nan
        self.map: OccupancyGrid | None = None
        self.frontiers = self.mission.frontiers
        self.refusal = ""
        self.told: tuple[str, list[OperatorOrder], str] | None = None
        self.told_s = -math.inf
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(OccupancyGrid, self.on_map, newest)
        self.subscribe(SearchedWalls, self.on_searched, newest)
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose")
        self.subscribe(MissionOrder, self.on_order, optional=True)
        self.subscribe(NavigationState, self.on_navigation)
        self.subscribe(VictimFound, self.on_victim)
        self.subscribe(CameraInfo, self.on_camera, newest, topic="camera")
        self.subscribe(BatteryState, self.on_battery, newest, topic="battery")

    def on_map(self, grid: OccupancyGrid) -> None:
        """Pass a new map to the mission."""
        self.map = grid
        self.mission.see_map(*map_cells(grid))

    def on_searched(self, grid: SearchedWalls) -> None:
        """Pass the searched walls to the mission."""
        self.mission.see_searched(SearchedGrid(*map_cells(grid)))

    def on_pose(self, message: PoseStamped) -> None:
        """Pass the robot's pose to the mission."""
        self.pose = planar(message.pose)
        self.mission.see_pose(self.pose)

    def on_camera(self, _camera: CameraInfo) -> None:
        """Record that the camera works."""
        self.mission.see_camera()

    def on_battery(self, battery: BatteryState) -> None:
        """Pass the battery's charge to the mission."""
        self.mission.limits.see_battery(battery.percentage)

    def on_victim(self, victim: VictimFound) -> None:
        """Pass a report of a victim to the mission."""
        position = victim.pose.position
        report = VictimReport(
            id=victim.id,
            name=victim.name,
            x_m=position.x,
            y_m=position.y,
            z_m=position.z,
            facing_rad=victim.pose.orientation.yaw,
            found_s=victim.header.stamp.nanoseconds / 1e9,
            confidence=victim.confidence,
            state=VictimState(victim.state),
        )
        self.mission.victims.see(report)

    def on_order(self, order: MissionOrder) -> None:
        """Carry out the operator's order at once, or publish why it is refused."""
        self.refusal = self.mission.order(order.order) or ""
        if self.refusal:
            self.log.warning("refused an order of %s: %s", self.envelope.sender, self.refusal)
        self.told_s = -math.inf
        self.tick()

    def on_navigation(self, state: NavigationState) -> None:
        """Pass navigation's state to the mission."""
        self.mission.see_stopped(
            f"{state.state}: {state.reason}" if state.state.startswith(CANNOT_DRIVE) else None
        )
        # Without a goal, navigation reports zeros, which must not be taken for a goal at the origin.
        self.is_known = self.goal is not None and state.state != "IDLE" and self._is_goal(state)
        if self.judged or not self.is_known or self.goal is None:
            return
        if state.state in ("ARRIVED", "UNREACHABLE"):
            self.judged = True
            self.log.debug("goal %s: %s %s", self.goal.round(2), state.state, state.reason)
            if state.state == "ARRIVED":
                self.mission.arrived()
            else:
                self.mission.unreachable(state.reason)

    def tick(self) -> None:
        """Let the mission decide, and send goals and directions to other modules."""
        orders = self.mission.step()
        # First of all, so that a restart does not forget the operator's order.
        self.checkpoint(self.mission.memory())
        if self.pose is not None and self.mission.state is not MissionState.WAIT:
            if self.mission.state in HOLDS:
                self._cancel_goal()
            else:
                self._send_goal(orders.goal)
            self._turn_camera(orders.look_at_xy_m)
        for note in self.mission.notes[self.notes_told :]:
            self.log.warning("%s", note)
        self.notes_told = len(self.mission.notes)
        self._tell()
        self.status = self.mission.status
        if self.mission.machine.is_final and self.mission.machine.time_in_state_s >= self.ends_after_s:
            self.log.info("the mission has ended: %s", self.status)
            self.stop()

    def teardown(self) -> None:
        """Write the report."""
        mission = self.mission
        figures = MissionFigures(
            state=mission.state.name,
            reason=mission.machine.reason,
            duration_s=mission.limits.used_s,
            battery=mission.limits.battery,
            notes=mission.notes,
        )
        write_report(
            self.output_directory,
            self.report_name,
            figures,
            None if self.map is None else map_cells(self.map),
            mission.searched,
            list(mission.victims.reports.values()),
            mission.path_m,
            mission.home,
        )

    def _tell(self) -> None:
        """Publish the mission's status if it is new or was published long ago; also new frontiers."""
        mission = self.mission
        told = (mission.state.name, mission.operator.fitting(mission.state), self.refusal)
        if told != self.told or self._time_s() - self.told_s >= TELL_S:
            self.told, self.told_s = told, self._time_s()
            state, orders, refusal = told
            header, text = self._header("map"), mission.status
            codes = np.array(orders, np.uint8)
            self.publish(MissionStatus(header=header, state=state, text=text, orders=codes, refusal=refusal))
            if mission.home is not None:
                home = PointOfInterest(name="home", pose=pose_stamped(mission.home, header).pose)
                self.publish(PointsOfInterest(header=header, points=[home]), topic="mission")
        if mission.frontiers is not self.frontiers:
            self.frontiers = mission.frontiers
            self.publish(frontiers_message(self.frontiers, self._header("map")))

    def _state_changed(self, state: MissionState) -> None:
        self.show_state(state)
        self.log.info("%s (%s)", state.name, self.mission.machine.reason)

    def _cancel_goal(self) -> None:
        """Cancel the mission's goal; again if navigation still drives to it after a restart.

        Meanwhile, the operator may send the robot to another goal.
        """
        now_s = self._time_s()
        if self.is_cancelled and not (self.is_known and now_s - self.sent_s >= REPEAT_S):
            return
        self.is_cancelled = self.judged = True
        self.is_known = self.stands = False
        self.sent_s = now_s
        self.publish(CancelGoal(header=self._header("map"), reason=self.mission.machine.reason))

    def _send_goal(self, wanted: NDArray[np.float64] | None) -> None:
        """Send a goal if it is new, or if navigation has lost it. To stand still, send the robot's pose."""
        if wanted is not None:
            goal = wanted
        else:
            goal = self.goal if self.stands and self.goal is not None else np.array(self.pose)
        self.stands = wanted is None
        now_s = self._time_s()
        is_new = self.is_cancelled or self.goal is None or not np.array_equal(goal, self.goal)
        is_wanted_again = self.judged and wanted is not None
        if not is_new and (now_s - self.sent_s < REPEAT_S or (self.is_known and not is_wanted_again)):
            return
        self.goal, self.sent_s = goal, now_s
        self.is_known = self.judged = self.is_cancelled = False
        self.publish(pose_stamped(goal, self._header("map")), topic="goal")

    def _is_goal(self, state: NavigationState) -> bool:
        """Return whether a state is about the goal that was sent last."""
        assert self.goal is not None
        x_m, y_m, heading_rad = np.asarray(planar(state.goal)) - self.goal
        # Compare the heading as well: successive goals may be at the same place with different headings.
        return math.hypot(x_m, y_m, math.remainder(heading_rad, math.tau)) < 1e-6

    def _turn_camera(self, look_at_xy_m: NDArray[np.float64] | None) -> None:
        assert self.pose is not None
        pan_rad = self.look.pan_rad(self._time_s(), self.pose, look_at_xy_m)
        if not abs(pan_rad - self.pan_rad) < 0.02:
            self.pan_rad = pan_rad
            self.publish(PanTiltCommand(header=self._header("base_link"), pan_rad=pan_rad))

    def _header(self, frame: str) -> Header:
        return Header(stamp=Time.from_nanoseconds(self.clock.now_ns()), frame_id=frame)

    def _time_s(self) -> float:
        return self.clock.monotonic_ns() / 1e9
