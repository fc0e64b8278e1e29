"""A simulated arm with a gripper, and the objects that it moves."""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robbie_mp import REQUIRED, Header, SettingError, Time, setting
from robbie_mp.messages import JointState
from robbie_mp.scene import RigidTransform, SceneGraphError
from robbie_mp.scene.conversion import to_pose
from robbie_robots.hw.joints import Joint, JointReading
from robbie_robots.hw.simulation.joints import SimulatedJoints
from robbie_robots.hw.simulation.solid import Solid, pose_at
from robbie_robots.hw.simulation.tabletop import TableObject, Tabletop
from robbie_robots.hw.simulation.taking_person import TakingPerson
from robbie_robots.hw.simulation.urdf_solids import UrdfShapeError
from robbie_robots.modules.devices.joints import CommandedJoints
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice
from robbie_robots.modules.manipulation.messages import TabletopTruth
from robbie_robots.modules.manipulation.robot_shapes import RobotShapes, table_solids
from robbie_robots.workers.manipulation.rotations import quaternion_of

PULL_N = 10.0
"""Force with which a person pulls at what the hand holds out."""

TAKES_M = 1.0
"""A person this near to the hand, seen from above, takes what it holds out."""

GRIP_N = 15.0
"""Force of the fingers on what they hold."""

GRIPPER = "gripper"
GRASP_POINT = "grasp_point"
DEFAULT_SPEED = 1.0
WITH_A_PERSON = "person"


class SimulatedArm(CommandedJoints, SimulatedDevice):
    """The joints of a simulated arm and its gripper; see `CommandedJoints`. Their limits are the URDF's.

    A command that expires leaves the arm standing where it is. The gripper is the joint `gripper`: its
    position is half of the opening, in m, and stops at what is between the fingers. The efforts in
    `JointState` are those of the fingers, in N, and of a person who pulls, in Nm, as servos measure them.

    A person near the hand tugs at what it holds out, and takes it when it lets go.

    Where the objects truly are goes out as `TabletopTruth` on `ground_truth`, and at the end into
    `arm.json`. Joints and objects survive a restart.
    """

    robot: Path = setting(REQUIRED, "the robot's URDF", must_exist=True)
    period_s: float = setting(0.04, "time between messages", minimum=0.005)
    rest: list[float] = setting([], "where the joints are at the start; default 0")

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check the joints' names against the URDF, and the arena."""
        super().check(settings)
        file, names, rest = settings["robot"], settings["names"], settings["rest"]
        assert isinstance(file, Path) and isinstance(names, list) and isinstance(rest, list)
        try:
            joints = RobotShapes(file).joints
        except (SceneGraphError, UrdfShapeError, OSError) as error:
            raise SettingError(str(error), "robot") from error
        moved = [name for name, joint in joints.items() if joint.mimic is None and joint.limits is not None]
        for name in (*names, GRIPPER):
            if name not in moved:
                raise SettingError(
                    f"{file} has no joint {name!r} with limits; it has {', '.join(moved)}", "names"
                )
        if GRIPPER not in names:
            raise SettingError(f"one of the joints must be {GRIPPER!r}", "names")
        if len(rest) not in (0, len(names)):
            raise SettingError(f"expected a value for each of the {len(names)} joints, or none", "rest")

    def setup(self) -> None:
        """Put the arm and the objects where they are at the start, or were before a restart."""
        self.world = SharedWorld(self)
        self.shapes = RobotShapes(self.robot)
        joints = [Joint(name, **self.limits(place)) for place, name in enumerate(self.names)]
        at = dict(zip(self.names, self.rest, strict=False))
        if self.restored is not None:
            at = self.restored["joints"]
        self.simulated = SimulatedJoints(joints, self.monotonic_s, at)
        self.moved = self.simulated
        self.objects = Tabletop(
            [
                TableObject(
                    one.name,
                    Solid(one.size_m, one.is_round),
                    pose_at((one.x_m, one.y_m, one.base_m + one.size_m[2] / 2), one.yaw_rad),
                )
                for one in self.world.arena.objects
            ],
            table_solids(self.world.arena),
            state=None if self.restored is None else self.restored["objects"],
        )
        self.person = TakingPerson(TAKES_M, PULL_N)
        self.obey()

    def limits(self, place: int) -> dict[str, float]:
        """Return the limits of one joint, as arguments of `Joint`."""
        joint = self.shapes.joints[self.names[place]]
        least, most = joint.limits or (0.0, 0.0)
        speed = joint.max_speed or DEFAULT_SPEED
        return {"least_rad": least, "most_rad": most, "speed_rad_per_s": speed}

    def tick(self) -> None:
        """Move the arm and what it holds; publish where everything is."""
        if self.world.truth is None:
            self.status = "waiting for the simulated base"
            return
        at = self._positions()
        self.shapes.move(at)
        robot = self.world.truth.pose
        hand = self.shapes.pose(GRASP_POINT, robot)
        least = self.objects.step(hand, at[GRIPPER], self.shapes.arm(robot), self.person.has_hold)
        self.simulated.block(GRIPPER, least or None)
        reading = self.simulated.read()
        held_out = hand[:3, 3] if self.objects.held else None
        pull = self.person.pull(self.monotonic_s(), held_out, self.world.people[:, :2])
        efforts = [self.shapes.torque_nm(name, robot, hand[:3, 3], pull) for name in self.names]
        now = self.now()
        self._publish(reading, np.array(efforts), now)
        memory = {"joints": self._positions(), "objects": self.objects.memory()}
        self.checkpoint({**memory, "orders": self.orders.memory})
        held = f"holds {self.objects.held}" if self.objects.held else "holds nothing"
        self.status = f"{held}, {self.figures(self.simulated.expired_commands)}"

    def teardown(self) -> None:
        """Write where the objects truly are, and what the arm touched, to `arm.json`."""
        objects = self.objects
        result = {
            "objects": {
                one.name: {"on": self._below(one.name), "lies": objects.lies(one.name)}
                for one in objects.objects
            },
            "held": objects.held,
            "slips": objects.slips,
            "contacts": objects.contacts,
            "expired_commands": self.simulated.expired_commands,
        }
        self.write_result("arm.json", json.dumps(result) + "\n")

    def _below(self, name: str) -> str:
        """Return where an object is: the name of a table, 'hand', 'person' or 'floor'."""
        if name == self.objects.held:
            return "hand"
        if self.objects.is_taken(name):
            return WITH_A_PERSON
        x, y, _ = self.objects.pose(name)[:3, 3].tolist()
        return next((table.name for table in self.world.arena.tables if table.is_below(x, y)), "floor")

    def _positions(self) -> dict[str, float]:
        return dict(zip(self.names, self.simulated.read().positions_rad, strict=True))

    def _publish(self, reading: JointReading, efforts: NDArray[np.float64], now: Time) -> None:
        """Publish the joints, with the force of the gripper, and the truth."""
        self.see_joints(reading)
        efforts[self.names.index(GRIPPER)] = -GRIP_N if self.simulated.is_pushing(GRIPPER) else 0.0
        self.publish(
            JointState(
                header=Header(stamp=now),
                name=self.names,
                position=np.array(reading.positions_rad),
                velocity=np.array(reading.speeds_rad_per_s),
                effort=efforts,
            ),
            topic=self.name,
        )
        objects = self.objects
        names = [one.name for one in objects.objects]
        matrices = [objects.pose(name) for name in names]
        self.publish(
            TabletopTruth(
                header=Header(stamp=now, frame_id="arena"),
                names=names,
                poses=[
                    to_pose(RigidTransform.of(matrix[:3, 3].tolist(), quaternion_of(matrix[:3, :3]).tolist()))
                    for matrix in matrices
                ],
                fallen=[name for name in names if objects.lies(name)],
                held=objects.held or "",
                slips=objects.slips,
                contacts=objects.contacts,
                taken=[name for name in names if objects.is_taken(name)],
            ),
            topic="ground_truth",
        )
