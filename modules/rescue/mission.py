"""Application control of the rescue robot: explores, searches for victims, asks the operator, comes home."""

import math
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from robbie_mp import CallRefused, Duration, Header, MessageHandling, SettingError, Time, setting
from robbie_mp.messages import (
    BatteryState,
    Bumper,
    CameraInfo,
    ControlState,
    DeviceState,
    OccupancyGrid,
    Point,
    PointOfInterest,
    PointsOfInterest,
    PoseStamped,
    SetControl,
)
from robbie_robots.hw.connection.device import ConnectionState
from robbie_robots.modules.devices.camera_turn import CameraTurn
from robbie_robots.modules.devices.command_age import check_order
from robbie_robots.modules.maps.planar_messages import frontiers_message, map_cells, planar, pose_stamped
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.modules.navigation.navigation_goals import NavigationGoals
from robbie_robots.modules.rescue.messages import (
    MissionResult,
    MissionStatus,
    OrderAccepted,
    OrderMission,
    SearchedWalls,
    VictimFound,
)
from robbie_robots.modules.rescue.team_messages import GoalClaim, MapAlignment
from robbie_robots.modules.sensor_deadlines import BATTERY_S
from robbie_robots.workers.exploration.team_claims import Claim, SeenInVain
from robbie_robots.workers.planar_pose import compose
from robbie_robots.workers.rescue.look_around import LookAround
from robbie_robots.workers.rescue.mission import Mission
from robbie_robots.workers.rescue.mission_orders import OperatorOrder
from robbie_robots.workers.rescue.mission_states import ENDS, MissionSettings, MissionState
from robbie_robots.workers.rescue.mission_targets import SearchedGrid
from robbie_robots.workers.rescue.mission_victims import VictimReport
from robbie_robots.workers.rescue.rescue_report import MissionFigures, known_m2, travelled_m, write_report
from robbie_robots.workers.rescue.victim_map import VictimState

CLAIM_VALID_S = 3.0
"""How long the others leave this robot's target alone when it falls silent."""

HOLDS = {MissionState.PAUSE} | ENDS
SETTLED = (VictimState.CONFIRMED, VictimState.REJECTED)
TELL_S = 1.0
"""Period of the mission's status while it does not change."""
CLAIM_PERIOD_S = 0.4


class RescueMission(MovingModule):
    """Sends goals to navigation and directions to the pan-tilt unit until the mission has ended.

    It sends one `NavigateTo` after another. With the service `OrderMission`, the operator starts, pauses or
    aborts the mission, or calls the robot home. `MissionStatus` says which orders the mission accepts now.
    The module also publishes the `Frontiers` that it can choose from.

    At the end, it publishes `MissionResult`, and writes the report: a map with victims and path in the style
    of RoboCup Rescue (`NAME_map.png`), the victims (`NAME_victims.csv`), and figures (`mission.json`). With
    `goes_on` the module goes on, for an operator who drives by hand, calls the robot home or
    starts another mission.

    After a restart, it continues: it still knows its home, the victims, the time used, the operator's order,
    and whether it was on its way home.
    """

    period_s: float = setting(0.2, "time between decisions", minimum=0.02)
    starts_by_itself: bool = setting(True, "false: the robot waits until the operator starts the mission")
    time_limit_s: float = setting(600.0, "time by which the robot is home again", minimum=10.0)
    pause_stops_time: bool = setting(False, "whether the time stands while the robot is paused")
    reserve: float = setting(
        0.15, "ratio of charge below which the battery is not used", minimum=0.0, maximum=1.0
    )
    clearance_m: float = setting(0.27, "distance of paths from obstacles; use navigation's", minimum=0.05)
    map_topic: str = setting("", "topic of the map to use, if the robot has several; '' for any")
    team: list[str] = setting([], "other robots, with which this one shares the work")
    gives_way_to: list[str] = setting([], "robots of the team that go first where their way meets this one's")
    devices: list[str] = setting(
        [],
        "modules of devices that may be pulled out: status and report say which are away, and which were",
    )
    report_name: str = setting("rescue", "prefix of the names of the report's files")
    ends_after_s: float = setting(
        1.0, "time between the end of the mission and that of the module", minimum=0.0
    )
    goes_on: bool = setting(False, "whether the module goes on after the mission, for another one")

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check that the robots that go first are of the team."""
        team, first = settings["team"], settings["gives_way_to"]
        assert isinstance(team, list)
        assert isinstance(first, list)
        for robot in first:
            if robot not in team:
                raise SettingError(f"{robot!r} is none of the team: {', '.join(team)}", "gives_way_to")

    def setup(self) -> None:
        """Create the mission; subscribe to map, pose, navigation, victims, camera and battery."""
        settings = MissionSettings(
            starts_by_itself=self.starts_by_itself,
            time_limit_s=self.time_limit_s,
            pause_stops_time=self.pause_stops_time,
            reserve=self.reserve,
            clearance_m=self.clearance_m,
            gives_way_to=tuple(self.gives_way_to),
        )
        self.mission = Mission(self.monotonic_s, settings, self._state_changed)
        if self.restored is not None:
            self.mission.remember(self.restored)
        self.notes_told = len(self.mission.notes)
        self.show_state(self.mission.state)
        self.look = LookAround()
        self.pose: tuple[float, float, float] | None = None
        self.pose_stamp = Time()
        self.goals = NavigationGoals(
            self,
            # Not bound to this mission: another one may follow it.
            lambda: self.mission.arrived(),  # noqa: PLW0108
            lambda reason: self.mission.unreachable(reason),  # noqa: PLW0108
            lambda reason: self.mission.see_stopped(reason),  # noqa: PLW0108
        )
        # With its feedback, navigation says whether the robot can drive.
        self.mission.see_stopped(None)
        self.camera_turn = CameraTurn(self)
        self.map: OccupancyGrid | None = None
        self.team_maps: dict[str, NDArray[np.float64]] = {}
        self.team_searched: dict[str, SearchedGrid] = {}
        self.claim_told_s = -math.inf
        self.frontiers = self.mission.frontiers
        self.told: tuple[str, list[OperatorOrder]] | None = None
        self.told_s = -math.inf
        self.has_told_result = False
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(OccupancyGrid, self.on_map, newest, topic=self.map_topic)
        every = MessageHandling.ALWAYS_DELIVER
        self.subscribe(SearchedWalls, self.on_searched, every if self.team else newest)
        for robot in self.team:
            self.subscribe(MapAlignment, self.on_alignment, topic=robot, optional=True)
            self.subscribe(GoalClaim, self.on_claim, newest, topic=robot, optional=True)
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose")
        self.subscribe(ControlState, self.on_control, newest, topic="control", optional=True)
        self.serve(OrderMission, self.on_order)
        self.subscribe(VictimFound, self.on_victim)
        self.subscribe(CameraInfo, self.on_camera, newest, topic="camera")
        self.subscribe(BatteryState, self.on_battery, newest, topic="battery", deadline_s=BATTERY_S)
        self.subscribe(Bumper, self.on_bumper, topic="bumper", optional=True)
        for device in self.devices:
            self.subscribe(DeviceState, self.on_device, topic=device, optional=True)

    def on_map(self, grid: OccupancyGrid) -> None:
        """Pass a new map to the mission, unless it is empty."""
        if not len(grid.data):
            return
        self.map = grid
        self.mission.see_map(*map_cells(grid))

    def on_searched(self, grid: SearchedWalls) -> None:
        """Pass the searched walls to the mission; keep those of other robots, and add them."""
        if not len(grid.data):
            return
        searched, robot = SearchedGrid(*map_cells(grid)), self.envelope.topic
        if robot in self.team:
            self.team_searched[robot] = searched.widened(self.mission.settings.min_wall_m)
            return
        searched.of_others = tuple(
            (walls, self.team_maps[one]) for one, walls in self.team_searched.items() if one in self.team_maps
        )
        self.mission.see_searched(searched)

    def on_alignment(self, alignment: MapAlignment) -> None:
        """Remember where another robot's map lies, as long as that is sure or known."""
        if alignment.is_sure or alignment.is_known:
            self.team_maps[alignment.robot] = np.array(planar(alignment.pose))
        else:
            self.team_maps.pop(alignment.robot, None)

    def on_claim(self, message: GoalClaim) -> None:
        """Pass another robot's claim to the mission, if the place of its map is known."""
        robot = self.envelope.topic
        if robot not in self.team_maps:
            return
        place = self.team_maps[robot]
        claim = Claim(
            pose=compose(place, planar(message.pose)),
            goal=compose(place, planar(message.goal)) if message.drives else None,
            target_xy_m=_placed(place, message.target) if message.has_target else None,
            way_m=message.way_m,
            is_working=message.is_working,
            home_xy_m=_placed(place, message.home) if message.has_home else None,
            seen_in_vain=(
                *_seen_in_vain(place, message.vain_frontiers, MissionState.EXPLORE),
                *_seen_in_vain(place, message.vain_walls, MissionState.SEARCH),
            ),
        )
        self.mission.claims.see(robot, claim, message.valid_for.nanoseconds / 1e9)

    def on_pose(self, message: PoseStamped) -> None:
        """Pass the robot's pose to the mission."""
        self.pose, self.pose_stamp = planar(message.pose), message.header.stamp
        self.mission.see_pose(self.pose)

    def on_control(self, control: ControlState) -> None:
        """Accept START while the robot waits for an order to go on, and say so at once."""
        self.mission.operator.must_order = control.mode != ControlState.AUTO
        self.told_s = -math.inf

    def on_camera(self, _camera: CameraInfo) -> None:
        """Record that the camera works."""
        self.mission.see_camera()

    def on_battery(self, battery: BatteryState) -> None:
        """Pass the battery's charge to the mission."""
        self.mission.limits.see_battery(battery.percentage)

    def on_bumper(self, bumper: Bumper) -> None:
        """Count collisions."""
        self.mission.see_bumper(is_pressed=bool(bumper.pressed))

    def on_device(self, device: DeviceState) -> None:
        """Pass to the mission whether a device can be used, and tell the operator at once."""
        before = self.mission.away
        self.mission.see_device(self.envelope.topic, is_connected=device.state == ConnectionState.CONNECTED)
        if self.mission.away != before:
            self.told_s = -math.inf

    def on_victim(self, victim: VictimFound) -> None:
        """Pass a report of a victim to the mission; another robot's only if it needs no more views."""
        robot, place, state = self.envelope.topic, np.array(planar(victim.pose)), VictimState(victim.state)
        if robot in self.team:
            if robot not in self.team_maps or state not in SETTLED:
                return
            place = compose(self.team_maps[robot], place)
        x_m, y_m, facing_rad = place.tolist()
        report = VictimReport(
            id=victim.id,
            name=victim.name,
            x_m=x_m,
            y_m=y_m,
            z_m=victim.pose.position.z,
            facing_rad=facing_rad,
            found_s=victim.header.stamp.nanoseconds / 1e9,
            confidence=victim.confidence,
            state=state,
        )
        if robot in self.team:
            self.mission.victims.settle(report)
        else:
            self.mission.victims.see(report)

    def on_order(self, order: OrderMission) -> OrderAccepted:
        """Carry out the operator's order at once, or say why it is refused."""
        if order.order in (OperatorOrder.START, OperatorOrder.RETURN):
            check_order(self)
        refusal = self.mission.order(order.order)
        if refusal is None and order.order == OperatorOrder.START and self.mission.has_ended:
            self._begin_another()
        if refusal is not None:
            self.log.warning("refused an order of %s: %s", self.envelope.sender, refusal)
            raise CallRefused(refusal)
        if order.order in (OperatorOrder.START, OperatorOrder.RETURN) and self.mission.operator.must_order:
            reason = f"{OperatorOrder(order.order).name} of the mission"
            self.call(SetControl(mode=ControlState.AUTO, reason=reason), lambda _reply: None)
        self.told_s = -math.inf
        self.tick()
        return OrderAccepted(state=self.mission.state.name)

    def act(self) -> None:
        """Let the mission decide, and send goals and directions to other modules."""
        orders = self.mission.step()
        # First of all, so that a restart does not forget the operator's order.
        self.checkpoint(self.mission.memory())
        if self.pose is not None and self.mission.state is not MissionState.WAIT:
            if self.mission.state in HOLDS:
                self.goals.cancel(self.mission.machine.reason)
            else:
                self.goals.drive_to(orders.goal, self.pose)
            self._turn_camera(orders.look_at_xy_m)
        for note in self.mission.notes[self.notes_told :]:
            self.log.warning("%s", note)
        self.notes_told = len(self.mission.notes)
        self._tell()
        if self.mission.has_ended and not self.has_told_result:
            self.publish(self._result(self._write_report()), latched=True)
        self.has_told_result = self.mission.has_ended
        self.status = self.mission.status
        is_over = self.mission.has_ended and not self.goes_on
        if is_over and self.mission.machine.time_in_state_s >= self.ends_after_s:
            self.log.info("the mission has ended: %s", self.status)
            self.stop()

    def teardown(self) -> None:
        """Write the report, unless the mission has ended and it is there."""
        if not self.has_told_result:
            self._write_report()

    def _begin_another(self) -> None:
        """Begin another mission where the robot stands."""
        self.mission = self.mission.following()
        self.notes_told = 0
        self.show_state(self.mission.state)
        self.log.info("mission %d begins", self.mission.number)

    def _write_report(self) -> list[str]:
        """Write the report, and return the names of its files."""
        mission = self.mission
        figures = MissionFigures(
            state=mission.state.name,
            reason=mission.machine.reason,
            duration_s=mission.limits.used_s,
            battery=mission.limits.battery,
            notes=mission.notes,
            collisions=mission.collisions,
        )
        return write_report(
            self.write_result,
            self.report_name,
            figures,
            None if self.map is None else map_cells(self.map),
            mission.searched,
            list(mission.victims.reports.values()),
            mission.path_m,
            mission.home,
            mission.number,
        )

    def _tell(self) -> None:
        """Publish the mission's status if it is new or was published long ago; also new frontiers."""
        mission = self.mission
        told = (mission.state.name, mission.operator.fitting(mission.state))
        if told != self.told or self.monotonic_s() - self.told_s >= TELL_S:
            self.told, self.told_s = told, self.monotonic_s()
            state, orders = told
            header, text = self._header(), mission.status
            codes = np.array(orders, np.uint8)
            self.publish(
                MissionStatus(
                    header=header,
                    state=state,
                    text=text,
                    orders=codes,
                    used_s=mission.limits.used_s,
                    limit_s=self.time_limit_s,
                )
            )
            if mission.home is not None:
                home = PointOfInterest(name="home", pose=pose_stamped(mission.home, header).pose)
                self.publish(PointsOfInterest(header=header, points=[home]), topic="mission")
        if mission.frontiers is not self.frontiers:
            self.frontiers = mission.frontiers
            self.publish(frontiers_message(self.frontiers, self._header()))
        if self.team and self.monotonic_s() - self.claim_told_s >= CLAIM_PERIOD_S:
            self._claim()

    def _claim(self) -> None:
        """Tell the team where this robot is, and what it drives to."""
        claim = self.mission.claim
        if claim is None:
            return
        self.claim_told_s = self.monotonic_s()
        header = self._header()
        self.publish(
            GoalClaim(
                header=header,
                pose=pose_stamped(claim.pose, header).pose,
                drives=claim.goal is not None,
                goal=pose_stamped(claim.pose if claim.goal is None else claim.goal, header).pose,
                has_target=claim.target_xy_m is not None,
                target=_point(claim.target_xy_m),
                way_m=claim.way_m,
                is_working=claim.is_working,
                has_home=claim.home_xy_m is not None,
                home=_point(claim.home_xy_m),
                vain_frontiers=_points(claim.seen_in_vain, MissionState.EXPLORE),
                vain_walls=_points(claim.seen_in_vain, MissionState.SEARCH),
                valid_for=Duration.from_nanoseconds(round(CLAIM_VALID_S * 1e9)),
            )
        )

    def _result(self, files: list[str]) -> MissionResult:
        mission = self.mission
        states = [report.state for report in mission.victims.reports.values()]
        mapped_m2 = 0.0 if self.map is None else known_m2(*map_cells(self.map)[:2])
        battery, searched = mission.limits.battery, mission.searched
        return MissionResult(
            header=self._header(),
            state=mission.state.name,
            reason=mission.machine.reason,
            used_s=mission.limits.used_s,
            limit_s=self.time_limit_s,
            confirmed=states.count(VictimState.CONFIRMED),
            unconfirmed=sum(state not in SETTLED for state in states),
            mapped_m2=mapped_m2,
            searched=math.nan if searched is None else searched.ratio,
            travelled_m=travelled_m(mission.path_m),
            collisions=-1 if mission.collisions is None else mission.collisions,
            battery=math.nan if battery is None else battery,
            notes=mission.notes,
            files=files,
        )

    def _state_changed(self, state: MissionState) -> None:
        self.show_state(state)
        self.log.info("%s (%s)", state.name, self.mission.machine.reason)

    def _turn_camera(self, look_at_xy_m: NDArray[np.float64] | None) -> None:
        assert self.pose is not None
        pan_rad = self.look.pan_rad(self.monotonic_s(), self.pose, look_at_xy_m)
        self.camera_turn.to(pan_rad, 0.0, self.pose_stamp)

    def _header(self) -> Header:
        return Header(stamp=self.now(), frame_id="map")


def _placed(map_pose: NDArray[np.float64], point: Point) -> NDArray[np.float64]:
    """Return a point of another robot's map in this robot's: `(2,)`, m."""
    x_m, y_m, _ = compose(map_pose, (point.x, point.y, 0.0)).tolist()
    return np.array([x_m, y_m])


def _seen_in_vain(
    map_pose: NDArray[np.float64], points: Iterable[Point], state: MissionState
) -> Iterator[SeenInVain]:
    """Yield the targets of one kind that another robot has seen in vain, in this robot's map."""
    for point in points:
        x_m, y_m = _placed(map_pose, point).tolist()
        yield SeenInVain(state.name, (x_m, y_m))


def _points(targets: Iterable[SeenInVain], state: MissionState) -> list[Point]:
    """Return what targets of one kind are about."""
    return [_point(np.array(target.about_xy_m)) for target in targets if target.kind == state.name]


def _point(xy_m: NDArray[np.float64] | None) -> Point:
    """Return a place as a message; the origin if there is none."""
    x_m, y_m = (0.0, 0.0) if xy_m is None else xy_m.tolist()
    return Point(x=x_m, y=y_m)
