"""Picks up objects with the robot's arm, and puts them down or hands them over."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from robbie_mp import (
    REQUIRED,
    ActiveGoal,
    CallRefused,
    Duration,
    Header,
    MessageHandling,
    SettingError,
    Time,
    replace,
    setting,
)
from robbie_mp.messages import ControlState, JointCommand, JointState
from robbie_mp.messages.calls import goal_types
from robbie_mp.messages.stock.robbie_msgs import MAX_VALID_FOR_S
from robbie_robots.modules.manipulation.messages import (
    HandOver,
    HandOverFeedback,
    HandOverResult,
    HandStatus,
    PickUp,
    PickUpFeedback,
    PickUpResult,
    PutDown,
    PutDownFeedback,
    PutDownResult,
    StowArm,
    StowArmFeedback,
    StowArmResult,
    TableObjects,
)
from robbie_robots.modules.manipulation.shape_messages import view_of
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.modules.sensor_deadlines import JOINTS_S
from robbie_robots.workers.manipulation.arm_model import ArmModel
from robbie_robots.workers.manipulation.errors import KinematicsMissing, ManipulationError
from robbie_robots.workers.manipulation.hand_work import HandOutcome, HandWork, JointOrder
from robbie_robots.workers.manipulation.hand_work_states import HandTask

PickUpGoal = ActiveGoal[PickUp, PickUpFeedback, PickUpResult]
PutDownGoal = ActiveGoal[PutDown, PutDownFeedback, PutDownResult]
HandOverGoal = ActiveGoal[HandOver, HandOverFeedback, HandOverResult]
StowArmGoal = ActiveGoal[StowArm, StowArmFeedback, StowArmResult]
AnyGoal = PickUpGoal | PutDownGoal | HandOverGoal | StowArmGoal
GOALS: dict[HandTask, Any] = {
    HandTask.PICK_UP: PickUp,
    HandTask.PUT_DOWN: PutDown,
    HandTask.HAND_OVER: HandOver,
    HandTask.STOW: StowArm,
}


class Manipulation(MovingModule):
    """Serves `PickUp`, `PutDown`, `HandOver` and `StowArm`, by what the depth camera and the joints tell.

    It publishes `JointCommand`, which expires, on topic `arm` while it has an order or holds something, and
    `HandStatus`. The order survives a restart: the arm stands still meanwhile, and its client notices
    nothing.
    """

    robot: Path = setting(REQUIRED, "the robot's URDF", must_exist=True)
    joints: list[str] = setting(
        ["waist", "shoulder", "elbow", "forearm_roll", "wrist_pitch", "wrist_roll"],
        "the arm's joints, from the base to the hand",
    )
    fingers: list[str] = setting(
        ["gripper", "right_finger"], "joints of the fingers in the URDF; the first one is commanded"
    )
    period_s: float = setting(0.05, "time between commands", minimum=0.01)
    command_valid_for_s: float = setting(
        0.3, "the arm stands when no newer command arrives", minimum=0.05, maximum=MAX_VALID_FOR_S
    )
    seed: int = setting(0, "random seed of the planner")

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the robot, so that a mistake, or a missing library, is reported before anything starts."""
        file, joints, fingers = settings["robot"], settings["joints"], settings["fingers"]
        assert isinstance(file, Path) and isinstance(joints, list) and isinstance(fingers, list)
        if not joints or not fingers:
            raise SettingError("the arm needs joints and fingers", "joints" if not joints else "fingers")
        try:
            ArmModel(file, joints, fingers)
        except KinematicsMissing:
            raise  # a profile may say that the robot does without its arm: `optional: true`
        except ManipulationError as error:
            raise SettingError(str(error)) from error

    def setup(self) -> None:
        """Create the worker; continue the order of the process before."""
        self.arm = ArmModel(self.robot, self.joints, self.fingers)
        self.work = HandWork(self.arm, self.monotonic_s, on_change=self.show_state, seed=self.seed)
        self.active: AnyGoal | None = None
        self.accepted_s = self.monotonic_s()
        self.released = ""
        self.fed_back = ""
        self.told: tuple[str, str, bool] | None = None
        self.joints_stamp = Time()
        self.holds = False
        self.order: JointOrder | None = None
        if self.restored is not None:
            self._restore(self.restored)
        self.show_state(self.work.machine.state)
        self.serve_goals(PickUp, self.on_pick_up, self.on_cancel)
        self.serve_goals(PutDown, self.on_put_down, self.on_cancel)
        self.serve_goals(HandOver, self.on_hand_over, self.on_cancel)
        self.serve_goals(StowArm, self.on_stow, self.on_cancel)
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(JointState, self.on_joints, newest, topic="arm", deadline_s=JOINTS_S)
        self.subscribe(TableObjects, self.on_table, newest)
        self.subscribe(ControlState, self.on_control, newest, topic="control", optional=True)

    def _restore(self, kept: dict[str, Any]) -> None:
        self.released, self.accepted_s, self.holds = kept["released"], kept["accepted_s"], kept["holds"]
        if kept["goal"] is not None:
            self.active = self.resume_goal(GOALS[HandTask(kept["task"])], kept["goal"])
        self.work.remember(kept["work"])

    def on_joints(self, state: JointState) -> None:
        """Pass the joints to the worker."""
        at = dict(zip(state.name, state.position.tolist(), strict=False))
        wanted = [*self.joints, self.fingers[0]]
        if all(name in at for name in wanted):
            self.joints_stamp = state.header.stamp
            positions = np.array([at[name] for name in self.joints])
            self.work.see_joints(positions, at[self.fingers[0]], self._stamp_s(state.header))
            if len(state.effort) == len(state.name):
                efforts = dict(zip(state.name, state.effort.tolist(), strict=True))
                self.work.see_efforts(np.array([efforts[name] for name in self.joints]))

    def on_control(self, control: ControlState) -> None:
        """Keep the arm where it is until somebody orders the robot to go on.

        Then it plans from where it is, as after a restart: its trajectory is of another time.
        """
        held, self.holds = self.holds, control.mode != ControlState.AUTO
        if held and not self.holds:
            kept = self.work.memory()
            self.work = HandWork(self.arm, self.monotonic_s, on_change=self.show_state, seed=self.seed)
            self.work.remember(kept)
        self._keep()

    def on_table(self, message: TableObjects) -> None:
        """Pass what the camera sees to the worker."""
        self.work.see_table(view_of(message, self._stamp_s(message.header)))

    def on_pick_up(self, active: PickUpGoal) -> None:
        """Pick up an object from now on."""
        if not active.goal.object:
            raise CallRefused("which object? Its name is empty")
        is_same = self.work.task is HandTask.PICK_UP and self.work.target == active.goal.object
        self._take(active)
        if not is_same:
            self.work.pick_up(active.goal.object)
        self._keep()

    def on_put_down(self, active: PutDownGoal) -> None:
        """Put down what is held from now on."""
        if not self._has_released(active.goal):
            self._release(active, HandTask.PUT_DOWN, self.work.put_down)
        else:
            active.succeed(PutDownResult())

    def on_hand_over(self, active: HandOverGoal) -> None:
        """Hand over what is held from now on."""
        if not self._has_released(active.goal):
            self._release(active, HandTask.HAND_OVER, self.work.hand_over)
        else:
            active.succeed(HandOverResult())

    def on_stow(self, active: StowArmGoal) -> None:
        """Move the arm above the robot from now on."""
        is_same = self.work.task is HandTask.STOW
        self._take(active)
        if not is_same:
            self.work.stow()
        self._keep()

    def _has_released(self, goal: PutDown | HandOver) -> bool:
        """Return whether its client's last process asked for the same, and did not hear of the end."""
        is_idle = self.work.task is None and self.work.held is None
        return is_idle and bool(goal.object) and goal.object == self.released

    def _release(self, active: PutDownGoal | HandOverGoal, task: HandTask, begin: Callable[[], None]) -> None:
        """Let go what is held from now on."""
        wanted, held = active.goal.object, self.work.held
        is_same = self.work.task is task and wanted in ("", self.work.target)
        if not is_same and held is None:
            raise CallRefused("there is nothing in the hand")
        if not is_same and held is not None and wanted not in ("", held.name):
            raise CallRefused(f"the hand holds {held.name}, not {wanted!r:.80}")
        self._take(active)
        if not is_same:
            begin()
        self._keep()

    def on_cancel(self, active: AnyGoal, reason: str) -> None:
        """Stand still, and end the goal."""
        if active is self.active:
            self.active = None
            self.work.stop(reason)
            self._keep()
        active.cancelled(reason)

    def act(self) -> None:
        """Send the joints where they should be now."""
        # An arm that holds is commanded on: without commands its joints are let go, and it falls.
        if not self.holds:
            self.order = self.work.step()
        order = self.order
        if self.active is not None and self.work.outcome is not None and self.work.task is None:
            self._end(self.active, self.work.outcome)
        elif self.active is not None:
            self._feed_back(self.active)
        if order is not None and (self.work.task is not None or self.work.held is not None):
            self.publish(
                JointCommand(
                    header=Header(stamp=self.now()),
                    name=[*self.joints, self.fingers[0]],
                    position=np.append(order.positions, order.half_opening_m),
                    valid_for=Duration.from_nanoseconds(round(self.command_valid_for_s * 1e9)),
                    based_on=self.joints_stamp,
                ),
                topic="arm",
            )
        self._keep()
        self._tell()
        held = f"holds {self.work.held.name}" if self.work.held is not None else "holds nothing"
        self.status = f"{held}; {self.work.machine.state.value} ({self.work.machine.reason})"

    def _take(self, active: AnyGoal) -> None:
        """Work for a new goal, in place of the one before."""
        before, self.active = self.active, active
        self.accepted_s, self.fed_back = self.monotonic_s(), ""
        if before is not None:
            before.preempt(f"{active.client} has sent another goal")

    def _end(self, active: AnyGoal, outcome: HandOutcome) -> None:
        """Tell the goal's client how it ended."""
        self.log.info("%s", outcome.text)
        self.active = None
        duration_s = self.monotonic_s() - self.accepted_s
        if outcome.is_done and not isinstance(active.goal, StowArm):
            self.released = "" if isinstance(active.goal, PickUp) else self.work.target
        self._keep()
        if not outcome.is_done:
            active.abort(outcome.text)
            return
        result = goal_types(type(active.goal))[1](duration_s=duration_s)
        if isinstance(result, PickUpResult):
            result = replace(result, width_m=2 * self.work.half_opening_m, tries=self.work.tries)
        active.succeed(result)

    def _feed_back(self, active: AnyGoal) -> None:
        state, reason = self.work.machine.state.name, self.work.machine.reason
        if self.fed_back == f"{state} {reason}":
            return
        self.fed_back = f"{state} {reason}"
        self.log.info("%s (%s)", state, reason)
        active.feedback(goal_types(type(active.goal))[0](state=state, reason=reason))

    def _tell(self) -> None:
        """Publish what the arm does and holds, if that has changed."""
        state, held = self.work.machine.state.name, self.work.held.name if self.work.held else ""
        stands_out = self.work.stands_out
        if self.told != (state, held, stands_out):
            self.told = state, held, stands_out
            header = Header(stamp=self.now())
            self.publish(
                HandStatus(header=header, state=state, held=held, stands_out=stands_out), latched=True
            )

    def _keep(self) -> None:
        """Keep what the next process needs."""
        active = self.active
        self.checkpoint(
            {
                "goal": None if active is None else active.memory,
                "task": None if self.work.task is None else str(self.work.task),
                "accepted_s": self.accepted_s,
                "released": self.released,
                "holds": self.holds,
                "work": self.work.memory(),
            }
        )

    def _stamp_s(self, header: Header) -> float:
        """Return the time of a message on this module's clock, which need not begin with the epoch."""
        age_s = (self.clock.now_ns() - header.stamp.nanoseconds) / 1e9
        return self.monotonic_s() - age_s
