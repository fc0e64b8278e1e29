"""Messages that only the robot with the arm knows."""

from typing import Any

from robbie_mp import DEFAULT, Feedback, Goal, Header, Message, Result, Upgrade, float64, uint32
from robbie_mp.messages import Pose, Vector3
from robbie_mp.messages.flaws import MAX_POSITION_M, Flaw, outside, unlike_lengths


def _nothing_taken(fields: dict[str, Any]) -> dict[str, Any]:
    """Name no object that a person has taken: version 1 knew no people."""
    return {**fields, "taken": []}


class TabletopTruth(
    Message,
    name="manipulation_msgs/msg/TabletopTruth",
    version=2,
    upgrades={
        1: Upgrade(_nothing_taken),
    },
):
    """Where the simulated objects truly are. Robots do not subscribe to it."""

    header: Header = DEFAULT  # frame_id: arena
    names: list[str] = DEFAULT
    poses: list[Pose] = DEFAULT  # of their middles
    fallen: list[str] = DEFAULT  # names of those that have fallen over
    held: str = DEFAULT  # what is in the hand; '': nothing
    slips: uint32 = DEFAULT  # how often something slipped out of the hand
    contacts: uint32 = DEFAULT  # how often the arm, or what it holds, began to touch a table or the floor
    taken: list[str] = DEFAULT  # names of those that people have taken out of the hand

    def flaw(self) -> Flaw | None:
        """Return whether an object has no pose."""
        return unlike_lengths(self, "names", "poses")


def _stowed(fields: dict[str, Any]) -> dict[str, Any]:
    """Take the arm for stowed: version 1 did not say."""
    return {**fields, "stands_out": False}


class SeenShape(Message, name="manipulation_msgs/msg/SeenShape", version=1):
    """A box, or an upright cylinder."""

    name: str = DEFAULT
    pose: Pose = DEFAULT  # of its middle
    size: Vector3 = DEFAULT  # m, extent in its own x, y and z
    is_round: bool = DEFAULT

    def flaw(self) -> Flaw | None:
        """Return a size that is negative or not finite, or an orientation that was never set."""
        flaw = outside(self.size, 0.0, MAX_POSITION_M, "x", "y", "z")
        if flaw is not None:
            return flaw._replace(field=f"size.{flaw.field}")
        turn = self.pose.orientation
        if not any((turn.x, turn.y, turn.z, turn.w)):
            return Flaw("pose.orientation", (0.0, 0.0, 0.0, 0.0), "a unit quaternion (x, y, z, w)")
        return None


class TableObjects(Message, name="manipulation_msgs/msg/TableObjects", version=1):
    """A table and what stands on it, as a camera sees them; sent for each image that shows a table."""

    header: Header = DEFAULT  # stamp: of the image; frame_id: base_link
    table: SeenShape = DEFAULT  # a box from the floor to the table's top, of the part that is seen
    objects: list[SeenShape] = DEFAULT  # names that are not known begin with "unknown"


class HandStatus(
    Message,
    name="manipulation_msgs/msg/HandStatus",
    version=2,
    upgrades={
        1: Upgrade(_stowed),
    },
):
    """What the arm does and holds. Latched, and published on each change."""

    header: Header = DEFAULT
    state: str = DEFAULT  # name of a state of workers/manipulation/hand_work_states.py
    held: str = DEFAULT  # what is in the hand; '': nothing
    stands_out: bool = (
        DEFAULT  # whether the arm has no order, but is not stowed: send StowArm before you drive
    )


class PickUpFeedback(Feedback, name="manipulation_msgs/action/PickUp_Feedback", version=1):
    """What the arm does; sent on each change."""

    state: str = DEFAULT  # such as LOOK, APPROACH, CLOSE
    reason: str = DEFAULT  # why it is in that state, in plain words


class PickUpResult(Result, name="manipulation_msgs/action/PickUp_Result", version=1):
    """The hand holds the object above the robot."""

    duration_s: float64 = DEFAULT
    width_m: float64 = DEFAULT  # of the gripper's opening
    tries: uint32 = DEFAULT  # grasps that failed before


class PickUp(Goal[PickUpFeedback, PickUpResult], name="manipulation_msgs/action/PickUp_Goal", version=1):
    """Pick up an object from the table in front of the robot. A newer goal replaces the older one."""

    object: str = DEFAULT  # its name


class PutDownFeedback(Feedback, name="manipulation_msgs/action/PutDown_Feedback", version=1):
    """What the arm does; sent on each change."""

    state: str = DEFAULT  # as in PickUpFeedback
    reason: str = DEFAULT  # why it is in that state, in plain words


class PutDownResult(Result, name="manipulation_msgs/action/PutDown_Result", version=1):
    """The object stands on the table, and the hand is empty."""

    duration_s: float64 = DEFAULT


class PutDown(Goal[PutDownFeedback, PutDownResult], name="manipulation_msgs/action/PutDown_Goal", version=1):
    """Put down what is in the hand on the table in front of the robot, where there is room."""

    object: str = DEFAULT  # its name; '': whatever it is


class HandOverFeedback(Feedback, name="manipulation_msgs/action/HandOver_Feedback", version=1):
    """What the arm does; sent on each change."""

    state: str = DEFAULT  # as in PickUpFeedback, or OFFER
    reason: str = DEFAULT  # why it is in that state, in plain words


class HandOverResult(Result, name="manipulation_msgs/action/HandOver_Result", version=1):
    """The hand is empty."""

    duration_s: float64 = DEFAULT


class HandOver(
    Goal[HandOverFeedback, HandOverResult], name="manipulation_msgs/action/HandOver_Goal", version=1
):
    """Hold out what is in the hand to somebody in front of the robot, and let it go after a moment."""

    object: str = DEFAULT  # its name; '': whatever it is


class StowArmFeedback(Feedback, name="manipulation_msgs/action/StowArm_Feedback", version=1):
    """What the arm does; sent on each change."""

    state: str = DEFAULT  # as in PickUpFeedback
    reason: str = DEFAULT  # why it is in that state, in plain words


class StowArmResult(Result, name="manipulation_msgs/action/StowArm_Result", version=1):
    """The arm is above the robot."""

    duration_s: float64 = DEFAULT


class StowArm(Goal[StowArmFeedback, StowArmResult], name="manipulation_msgs/action/StowArm_Goal", version=1):
    """Move the arm above the robot, with what it holds, so that the robot can drive."""
