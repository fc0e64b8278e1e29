"""Application control of the robot that drives to numbered signs in order."""

import json

import numpy as np

from robbie_mp import Header, MessageHandling, Time, setting
from robbie_mp.messages import OccupancyGrid, PoseStamped
from robbie_robots.modules.devices.camera_turn import CameraTurn
from robbie_robots.modules.maps.planar_messages import map_cells, planar
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.modules.navigation.navigation_goals import NavigationGoals
from robbie_robots.modules.numbers.messages import NumberSigns, SignsReached
from robbie_robots.workers.numbers.mission import NumbersMission
from robbie_robots.workers.numbers.mission_states import NumbersSettings, NumbersState
from robbie_robots.workers.numbers.mission_targets import SignReport
from robbie_robots.workers.rescue.look_around import LookAround

AROUND_RAD = (0.0, 0.8, 1.6, 2.4, -2.4, -1.6, -0.8, 0.0)


class Numbers(MovingModule):
    """Drives to the signs 0 to 9 in ascending order, or in that of the sheet that is shown at the start.

    It sends `NavigateTo` and `PanTiltCommand`, and says which digits it has reached with `SignsReached`. It
    needs `NumberSigns`. At the end it writes `numbers.json` to the run's results. After a restart it goes on.
    """

    period_s: float = setting(0.2, "time between decisions", minimum=0.02)
    time_limit_s: float = setting(900.0, "the robot stops after this time", minimum=10.0)
    clearance_m: float = setting(0.27, "distance of paths from obstacles; use navigation's", minimum=0.05)

    def setup(self) -> None:
        """Create the mission; subscribe to map, pose and signs."""
        settings = NumbersSettings(time_limit_s=self.time_limit_s, clearance_m=self.clearance_m)
        self.mission = NumbersMission(self.monotonic_s, settings, self._state_changed)
        self.told = 0
        if self.restored is not None:
            self.mission.remember(self.restored)
        mission = self.mission
        self.show_state(mission.state)
        self.goals = NavigationGoals(self, mission.arrived, mission.unreachable, mission.see_stopped)
        # With its feedback, navigation says whether the robot can drive.
        mission.see_stopped(None)
        self.look = LookAround(step_s=0.9, around_rad=AROUND_RAD)
        self.pose: tuple[float, float, float] | None = None
        self.pose_stamp = Time()
        self.camera_turn = CameraTurn(self)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(OccupancyGrid, self.on_map, newest)
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose")
        self.subscribe(NumberSigns, self.on_signs, newest)

    def on_map(self, grid: OccupancyGrid) -> None:
        """Pass a new map to the mission."""
        self.mission.see_map(*map_cells(grid))

    def on_pose(self, message: PoseStamped) -> None:
        """Pass the robot's pose to the mission."""
        self.pose, self.pose_stamp = planar(message.pose), message.header.stamp
        self.mission.see_pose(self.pose)

    def on_signs(self, message: NumberSigns) -> None:
        """Pass what is known about signs to the mission."""
        rows = zip(
            message.x_m.tolist(),
            message.y_m.tolist(),
            message.facing_rad.tolist(),
            message.digits.tolist(),
            message.likely.tolist(),
            message.views.tolist(),
            message.searched.tolist(),
            strict=True,
        )
        signs = [
            SignReport(
                xy_m=(x, y),
                facing_rad=facing,
                digit=digit if digit >= 0 else None,
                is_open=digit == NumberSigns.UNKNOWN,
                searched=searched,
                likely=likely if likely >= 0 else None,
                views=views,
            )
            for x, y, facing, digit, likely, views, searched in rows
        ]
        self.mission.see_signs(signs, message.sheet, message.images)

    def act(self) -> None:
        """Let the mission decide, and send goals and directions to other modules."""
        orders = self.mission.step()
        if len(self.mission.reached) != self.told:
            self.told = len(self.mission.reached)
            digits = np.array(self.mission.reached, np.uint8)
            self.publish(SignsReached(header=Header(stamp=self.now(), frame_id="map"), digits=digits))
        self.checkpoint(self.mission.memory())
        state = self.mission.state
        if state is NumbersState.DONE:
            self.goals.cancel(self.mission.machine.reason)
        elif self.pose is not None and state is not NumbersState.WAIT:
            self.goals.drive_to(orders.goal, self.pose)
            pan_rad = 0.0
            if state is not NumbersState.SHEET:
                pan_rad = self.look.pan_rad(self.monotonic_s(), self.pose, orders.look_at_xy_m)
            self.camera_turn.to(pan_rad, 0.0, self.pose_stamp)
        self.status = self.mission.status
        if self.mission.machine.is_final and self.mission.machine.time_in_state_s >= 1.0:
            self.log.info("the task has ended: %s", self.status)
            self.stop()

    def teardown(self) -> None:
        """Write the results."""
        mission = self.mission
        results = {
            "state": mission.state.name,
            "reason": mission.machine.reason,
            "order": list(mission.order),
            "reached": mission.reached,
            "used_s": round(mission.used_s, 2),
            "signs": [
                {"digit": sign.digit, "x_m": round(sign.xy_m[0], 3), "y_m": round(sign.xy_m[1], 3)}
                for sign in mission.signs
                if sign.digit is not None
            ],
        }
        self.write_result("numbers.json", json.dumps(results) + "\n")

    def _state_changed(self, state: NumbersState) -> None:
        self.show_state(state)
        self.log.info("%s (%s)", state.name, self.mission.machine.reason)
