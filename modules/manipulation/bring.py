"""Application control of the robot that brings objects from one place to another."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from modules.manipulation.messages import (
    Bring,
    BringFeedback,
    BringResult,
    PickUp,
    PickUpResult,
    PutDown,
    PutDownResult,
)
from modules.navigation_goals import NavigationGoals
from modules.planar_messages import planar
from robbie_mp import (
    ActiveGoal,
    CallError,
    CallRefused,
    GoalAborted,
    MessageHandling,
    Module,
    SentGoal,
    SettingError,
    setting,
)
from robbie_mp.messages import PoseStamped
from workers.manipulation.bring import BringMission, BringOrder, BringState

BringGoal = ActiveGoal[Bring, BringFeedback, BringResult]
REPEAT_S = 1.0
"""Time after which the arm is told again what an accident has kept from it."""


class Bringer(Module):
    """Serves `Bring`, by `NavigateTo`, `PickUp` and `PutDown`.

    With `orders`, it carries these out after its start, and then ends. The order survives a restart.
    It writes `bring.json` to the run's results.
    """

    period_s: float = setting(0.2, "time between decisions", minimum=0.02)
    places: list[str] = setting([], "names of the places in front of tables")
    x_m: list[float] = setting([], "x of each place, map frame")
    y_m: list[float] = setting([], "y of each place, map frame")
    heading_rad: list[float] = setting([], "heading of each place, map frame")
    orders: list[str] = setting([], "orders of the start, such as 'soup: table -> counter'")

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check that the lists fit, and the orders."""
        places, orders = settings["places"], settings["orders"]
        assert isinstance(places, list) and isinstance(orders, list)
        for name in ("x_m", "y_m", "heading_rad"):
            values = settings[name]
            if (
                not isinstance(values, list)
                or len(values) != len(places)
                or not all(map(math.isfinite, values))
            ):
                raise SettingError(f"expected a finite number for each of the {len(places)} places", name)
        if len(set(places)) < len(places):
            raise SettingError("each place needs a name that no other has", "places")
        for text in orders:
            order = parsed(text)
            for place in (order.source, order.target):
                if place not in places:
                    raise SettingError(f"{text!r}: there is no place {place!r}; there are {places}", "orders")

    def setup(self) -> None:
        """Subscribe; continue the order of the process before."""
        self.mission = BringMission(self._time_s, self._state_changed)
        self.open = [parsed(text) for text in self.orders]
        self.active: BringGoal | None = None
        self.arm: SentGoal | None = None
        self.arm_is_sent = False
        self.sent_s = -math.inf
        self.pose: tuple[float, float, float] | None = None
        self.stopped: str | None = "waiting for navigation"
        self.fed_back = ""
        if self.restored is not None:
            self._restore(self.restored)
        self.show_state(self.mission.machine.state)
        self.goals = NavigationGoals(self, self.mission.arrived, self.mission.unreachable, self._see_stopped)
        self.serve_goals(Bring, self.on_order, self.on_cancel)
        self.subscribe(PoseStamped, self.on_pose, MessageHandling.KEEP_ONLY_NEWEST, topic="map_pose")

    def _restore(self, kept: dict[str, Any]) -> None:
        self.open = [BringOrder(*order) for order in kept["open"]]
        if kept["goal"] is not None:
            self.active = self.resume_goal(Bring, kept["goal"])
        self.mission.remember(kept["mission"])

    def on_pose(self, message: PoseStamped) -> None:
        """Take the robot's pose."""
        self.pose = planar(message.pose)

    def on_order(self, active: BringGoal) -> None:
        """Begin an order."""
        order = BringOrder(active.goal.object, active.goal.source, active.goal.target)
        if not order.object:
            raise CallRefused("which object? Its name is empty")
        for place in (order.source, order.target):
            if place not in self.places:
                raise CallRefused(f"there is no place {place!r:.80}; there are: {', '.join(self.places)}")
        if self.mission.order is not None or self.open:
            raise CallRefused("the robot has another order")
        self.active, self.fed_back = active, ""
        self.mission.begin(order)
        self._keep()

    def on_cancel(self, active: BringGoal, reason: str) -> None:
        """End the order; the robot stands where it is, and holds what it holds."""
        if active is self.active:
            self.active = None
            self.mission.cancel(reason)
            self._keep()
        active.cancelled(reason)

    def tick(self) -> None:
        """Have navigation and the arm do what is due."""
        mission = self.mission
        if mission.order is None and self.open and self.pose is not None:
            mission.begin(self.open.pop(0))
        mission.step()
        if self.pose is not None:
            if mission.place is not None:
                place = self.places.index(mission.place)
                goal = np.array([self.x_m[place], self.y_m[place], self.heading_rad[place]])
                self.goals.drive_to(goal, self.pose)
            else:
                self.goals.cancel(mission.machine.reason)
        self._tell_arm()
        self._tell_client()
        self._keep()
        order = mission.order
        what = "no order" if order is None else f"{order.object} from {order.source} to {order.target}"
        done = sum(end.is_done for end in mission.ends)
        self.status = f"{what}: {mission.machine.state.value}; {done} done, {len(mission.ends) - done} failed"
        is_over = self.orders and not self.open and order is None
        if is_over and mission.machine.time_in_state_s >= 1.0:
            self.log.info("all orders have ended: %s", self.status)
            self.stop()

    def teardown(self) -> None:
        """Write how the orders ended."""
        ends = [
            {
                **end.order._asdict(),
                "is_done": end.is_done,
                "reason": end.reason,
                "duration_s": round(end.duration_s, 2),
            }
            for end in self.mission.ends
        ]
        (self.output_directory / "bring.json").write_text(json.dumps(ends) + "\n")

    # -- the arm -----------------------------------------------------------------------------------------

    def _tell_arm(self) -> None:
        """Have the arm do what is due, once; and again if that got lost."""
        task, order = self.mission.arm_task, self.mission.order
        if task is None or order is None:
            if self.arm is not None and self.arm.is_active:
                self.arm.cancel("not wanted any more")
            self.arm = None
            return
        if self.arm is not None or self._time_s() - self.sent_s < REPEAT_S:
            return
        self.sent_s = self._time_s()
        if task is BringState.PICK:
            self.arm = self.send_goal(PickUp(object=order.object), self._on_picked_up, self._on_arm_error)
        else:
            self.arm = self.send_goal(PutDown(object=order.object), self._on_put_down, self._on_arm_error)

    def _on_picked_up(self, _result: PickUpResult) -> None:
        self.arm = None
        if self.mission.arm_task is BringState.PICK:
            self.mission.arm_done()

    def _on_put_down(self, _result: PutDownResult) -> None:
        self.arm = None
        if self.mission.arm_task is BringState.PUT:
            self.mission.arm_done()

    def _on_arm_error(self, error: CallError) -> None:
        """Give up what the arm cannot do; `_tell_arm` repeats what an accident has ended."""
        self.arm = None
        self.log.warning("the arm: %s: %s", type(error).__name__, error)
        if isinstance(error, GoalAborted | CallRefused):
            self.mission.arm_failed(str(error))

    # -- clients -----------------------------------------------------------------------------------------

    def _see_stopped(self, reason: str | None) -> None:
        self.stopped = reason

    def _tell_client(self) -> None:
        """Tell the order's client how far the robot is, or how it ended."""
        active = self.active
        if active is None:
            return
        if self.mission.order is None:
            end = self.mission.ends[-1]
            self.active = None
            self._keep()
            if end.is_done:
                active.succeed(BringResult(duration_s=end.duration_s))
            else:
                active.abort(end.reason)
            return
        state, reason = self.mission.machine.state.name, self.mission.machine.reason
        if self.fed_back != state + reason:
            self.fed_back = state + reason
            active.feedback(BringFeedback(state=state, reason=reason))

    def _state_changed(self, state: BringState) -> None:
        self.show_state(state)
        self.log.info("%s (%s)", state.name, self.mission.machine.reason)

    def _keep(self) -> None:
        self.checkpoint(
            {
                "mission": self.mission.memory(),
                "open": [list(order) for order in self.open],
                "goal": None if self.active is None else self.active.memory,
            }
        )

    def _time_s(self) -> float:
        return self.clock.monotonic_ns() / 1e9


def parsed(text: str) -> BringOrder:
    """Return the order of a text such as 'soup: table -> counter'.

    Raises:
        SettingError: the text has another form.
    """
    name, colon, way = text.partition(":")
    source, arrow, target = way.partition("->")
    order = BringOrder(name.strip(), source.strip(), target.strip())
    if not (colon and arrow and all(order)):
        raise SettingError(f"an order is written as 'soup: table -> counter', not {text!r}", "orders")
    return order
