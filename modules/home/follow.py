"""Application control of the robot that follows a person."""

import json
import math
from dataclasses import replace as changed

import numpy as np

from robbie_mp import CallRefused, Header, MessageHandling, Time, setting
from robbie_mp.messages import OccupancyGrid, Point, PoseStamped
from robbie_robots.modules.devices.camera_turn import MIN_TURN_RAD, CameraTurn
from robbie_robots.modules.devices.command_age import is_late
from robbie_robots.modules.home.messages import Following, FollowOrder, FollowOrderTaken
from robbie_robots.modules.maps.planar_messages import map_cells, planar
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.modules.navigation.navigation_goals import NavigationGoals
from robbie_robots.modules.people.messages import People, PeopleClothes
from robbie_robots.modules.people.people import PEOPLE, reports_of
from robbie_robots.modules.speech.messages import Say, SpokenOrder
from robbie_robots.workers.home.follow import Follow
from robbie_robots.workers.home.follow_states import FollowSettings, FollowState
from robbie_robots.workers.people.clothes import PART_BINS, PARTS_M
from robbie_robots.workers.rescue.look_around import LookAround

TELL_PERIOD_S = 0.2
"""Time between messages about what it does."""

BINS = len(PARTS_M) * PART_BINS
TILT_RAD = 0.1
"""The camera looks a little down, so that it sees clothes from shoulders to knees."""
AROUND_RAD = (0.0, 0.8, 1.6, 2.4, -2.4, -1.6, -0.8)


class FollowMe(MovingModule):
    """Follows the person in front of the robot on the order `follow`, until `stop`.

    Takes orders as `SpokenOrder` and as calls of `FollowOrder`. It needs `People`, `PeopleClothes` to be
    sure whom it sees, and `OccupancyGrid` to search for a person that it has lost. It sends `NavigateTo` and
    `PanTiltCommand`, speaks by `Say`, and publishes `Following`. At the end it writes `follow.json`. After a
    restart it goes on.
    """

    period_s: float = setting(0.1, "time between decisions", minimum=0.02)
    behind_m: float = setting(1.0, "distance behind the person, on the person's way", minimum=0.6)

    def setup(self) -> None:
        """Create the task; subscribe to orders, people and pose."""
        near_m = self.behind_m + 0.2
        settings = changed(FollowSettings(), behind_m=self.behind_m, near_m=near_m, away_m=near_m + 0.2)
        self.task = Follow(self.monotonic_s, settings, self._state_changed)
        if self.restored is not None:
            self.task.remember(self.restored)
        self.show_state(self.task.state)
        self.goals = NavigationGoals(self, self.task.arrived, self.task.unreachable, self.task.see_stopped)
        self.look = LookAround(step_s=0.9, around_rad=AROUND_RAD)
        self.pose: tuple[float, float, float] | None = None
        self.pose_stamp = Time()
        self.camera_turn = CameraTurn(self, 2 * MIN_TURN_RAD)
        self.told_s = -math.inf
        self.wrong_clothes = 0
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.advertise(Say)
        self.serve(FollowOrder, self.on_call)
        self.subscribe(SpokenOrder, self.on_order, optional=True)
        self.subscribe(PoseStamped, self.on_pose, newest, topic="map_pose")
        self.subscribe(OccupancyGrid, self.on_map, newest, optional=True)
        self.subscribe(People, self.on_people, newest, topic=PEOPLE)
        self.subscribe(PeopleClothes, self.on_clothes, newest, optional=True)

    def on_order(self, order: SpokenOrder) -> None:
        """Do what somebody has said, if it concerns this task."""
        if order.order != "stop" and is_late(self):
            self.log.warning("ignored a late order: %s", order.text)
            return
        self._obey(order.order)

    def on_call(self, request: FollowOrder) -> FollowOrderTaken:
        """Do what a program or a button says."""
        taken = self._obey(request.order)
        if taken is None:
            raise CallRefused(f"there is no order {request.order!r:.80}; there are: follow, stop, here")
        return FollowOrderTaken(changed=taken, state=self.task.state.name)

    def _obey(self, order: str) -> bool | None:
        """Return whether an order changes anything; None if it is no order of this task."""
        task = self.task
        orders = {"follow": task.order_follow, "stop": task.order_stop, "here": task.order_here}
        if order not in orders:
            return None
        taken = orders[order]()
        self.log.info("order %s: %s", order, "taken" if taken else f"changes nothing in {task.state.name}")
        self.checkpoint(task.memory())
        return taken

    def on_pose(self, message: PoseStamped) -> None:
        """Pass the robot's pose to the task."""
        self.pose, self.pose_stamp = planar(message.pose), message.header.stamp
        self.task.see_pose(self.pose)

    def on_map(self, grid: OccupancyGrid) -> None:
        """Pass the map to the task, which searches on it."""
        self.task.see_map(*map_cells(grid))

    def on_people(self, message: People) -> None:
        """Pass the persons to the task."""
        self.task.see_persons(reports_of(message, self.clock.now_ns()))

    def on_clothes(self, message: PeopleClothes) -> None:
        """Pass the persons' clothes to the task."""
        if message.clothes.size != len(message.names) * BINS:
            self.wrong_clothes += 1
            return
        rows = message.clothes.reshape(-1, BINS).astype(np.float64)
        self.task.see_clothes(dict(zip(message.names, rows, strict=True)))

    def act(self) -> None:
        """Let the task decide, and send goals, directions and words to other modules."""
        task = self.task
        orders = task.step()
        for text in task.sayings():
            self.log.info('says "%s"', text)
            self.publish(Say(text=text))
        self.checkpoint(task.memory())
        if task.state is FollowState.IDLE:
            self.goals.cancel(task.machine.reason)
        elif self.pose is not None and task.state is not FollowState.CHOOSE:
            self.goals.drive_to(orders.goal, self.pose)
        if self.pose is not None and task.state is not FollowState.IDLE:
            ahead = task.state is FollowState.CHOOSE
            pan_rad = self.look.pan_rad(self.monotonic_s(), self.pose, orders.look_at_xy_m)
            self.camera_turn.to(0.0 if ahead else pan_rad, TILT_RAD, self.pose_stamp)
        if self.monotonic_s() - self.told_s >= TELL_PERIOD_S:
            self.told_s = self.monotonic_s()
            self._tell()
        self.status = task.status

    def teardown(self) -> None:
        """Write what was counted."""
        task = self.task
        counted = {"state": task.state.name, "losses": task.losses, "questions": task.questions}
        self.write_result("follow.json", json.dumps(counted) + "\n")

    def _tell(self) -> None:
        task = self.task
        x, y = task.believed_xy_m or (0.0, 0.0)
        self.publish(
            Following(
                header=Header(stamp=self.now(), frame_id="map"),
                state=task.state.name,
                reason=task.machine.reason,
                person=task.person,
                position=Point(x=x, y=y),
                unseen_s=task.unseen_s,
                losses=task.losses,
                questions=task.questions,
            )
        )

    def _state_changed(self, state: FollowState) -> None:
        self.show_state(state)
        self.log.info("%s (%s)", state.name, self.task.machine.reason)
