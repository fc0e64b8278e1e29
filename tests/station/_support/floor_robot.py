"""Copied into the workspace of tests: a robot that stands on a known floor, with cameras ahead and behind.

The test writes what differs from usual into `floor.json` beside the profile; the robot records its orders.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from robbie_mp import ActiveGoal, CallRefused, Duration, Header, Module, Time
from robbie_mp.messages import (
    CameraInfo,
    ControlState,
    DriveCommand,
    Image,
    NavigateTo,
    NavigationFeedback,
    NavigationResult,
    PathPlanned,
    PlanPath,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_mp.messages import Path as PathMessage
from robbie_mp.scene import RigidTransform

WIDTH, HEIGHT = 160, 120
K = np.array([130.0, 0.0, 82.0, 0.0, 132.0, 58.0, 0.0, 0.0, 1.0])
DISTORTION = np.array([-0.12, 0.02, 0.001, -0.001, 0.0])
OPTICAL = RigidTransform(0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5)
ROBOT = (1.5, 3.25, 0.6)
"""x, y (m) and heading (rad) on the map."""
EYE_M, DOWN_RAD = (0.2, 0.05, 0.6), 0.5
USUAL: dict[str, Any] = {
    "calibrated": True,
    "late_s": 0.0,
    "has_pose": True,
    "odom_x_m": 0.0,
    "pan_rad": 0.0,
    "down_rad": DOWN_RAD,
    "drive": None,
    "refuses": "",
    "mode": ControlState.AUTO,
}


def mount(pan_rad: float, down_rad: float = DOWN_RAD) -> RigidTransform:
    """Where a camera is on the robot, X_BC."""
    return RigidTransform.from_rpy(EYE_M, (0.0, down_rad, pan_rad)) @ OPTICAL


def info() -> CameraInfo:
    """What a calibrated camera tells."""
    return CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob", k=K, d=DISTORTION)


def transform(header: Header, child: str, pose: RigidTransform) -> TransformStamped:
    x, y, z, qx, qy, qz, qw = pose
    turned = Quaternion(x=qx, y=qy, z=qz, w=qw)
    placed = Transform(translation=Vector3(x=x, y=y, z=z), rotation=turned)
    return TransformStamped(header=header, child_frame_id=child, transform=placed)


class FloorRobot(Module):
    """Tells where it and its cameras are, ten times a second, and records presses that become orders."""

    period_s = 0.05

    def setup(self) -> None:
        self.file = (self.output_directory / "floor.txt").open("a")
        self.now_is = USUAL
        self.is_rear = False
        self.serve(PlanPath, self.on_plan)
        self.serve_goals(NavigateTo, self.on_goal)

    def tick(self) -> None:
        wish = Path("floor.json")
        self.now_is = {**USUAL, **(json.loads(wish.read_text()) if wish.exists() else {})}
        stamp = self.now()
        taken = Time.from_nanoseconds(stamp.nanoseconds - round(1e9 * self.now_is["late_s"]))
        self.tell_where(stamp)
        self.publish(ControlState(mode=self.now_is["mode"], reason="of the test"), topic="control")
        self.is_rear = not self.is_rear
        self.take("rear" if self.is_rear else "eye", taken)  # in turns: a page keeps only the newest
        if self.now_is["drive"] is not None:
            linear, angular = self.now_is["drive"]
            valid = Duration.from_nanoseconds(300_000_000)
            self.publish(
                DriveCommand(
                    linear_m_per_s=linear, angular_rad_per_s=angular, valid_for=valid, based_on=stamp
                )
            )

    def tell_where(self, stamp: Time) -> None:
        x_m, y_m, yaw_rad = ROBOT
        shift_m = self.now_is["odom_x_m"]
        header = {frame: Header(stamp=stamp, frame_id=frame) for frame in ("map", "odom", "base_link")}
        base = RigidTransform.from_rpy((x_m, y_m, 0.0), (0.0, 0.0, yaw_rad))
        frames = [
            transform(header["map"], "odom", RigidTransform.from_rpy((shift_m, 0.0, 0.0))),
            transform(header["odom"], "base_link", base),
            transform(
                header["base_link"], "eye_optical", mount(self.now_is["pan_rad"], self.now_is["down_rad"])
            ),
            transform(header["base_link"], "rear_optical", mount(np.pi)),
        ]
        self.publish(TFMessage(transforms=frames), topic="tf")
        if self.now_is["has_pose"]:
            pose = Pose(position=Point(x=x_m + shift_m, y=y_m), orientation=Quaternion.from_yaw(yaw_rad))
            self.publish(PoseStamped(header=header["map"], pose=pose), topic="map_pose")

    def take(self, topic: str, taken: Time) -> None:
        header = Header(stamp=taken, frame_id=f"{topic}_optical")
        told = info() if self.now_is["calibrated"] else CameraInfo(width=WIDTH, height=HEIGHT)
        self.publish(told, topic=topic, latched=True)
        pixels = np.full(WIDTH * HEIGHT, 90, np.uint8)
        self.publish(
            Image(header=header, width=WIDTH, height=HEIGHT, encoding="mono8", step=WIDTH, data=pixels),
            topic=topic,
        )

    def on_plan(self, request: PlanPath) -> PathPlanned:
        goal = request.pose.pose.position
        self.write(
            "plan", goal.x, goal.y, *(number for eye in request.seen_from for number in (eye.x, eye.y))
        )
        if self.now_is["refuses"]:
            raise CallRefused(self.now_is["refuses"])
        way = np.linspace((ROBOT[0], ROBOT[1]), (goal.x, goal.y), 30)
        poses = [PoseStamped(pose=Pose(position=Point(x=x, y=y))) for x, y in way.tolist()]
        return PathPlanned(path=PathMessage(poses=poses))

    def on_goal(self, active: ActiveGoal[NavigateTo, NavigationFeedback, NavigationResult]) -> None:
        goal = active.goal.pose
        self.write("goal", goal.pose.position.x, goal.pose.position.y, goal.header.frame_id)
        active.succeed(NavigationResult())

    def write(self, *words: object) -> None:
        print(*words, file=self.file, flush=True)

    def teardown(self) -> None:
        self.file.close()
