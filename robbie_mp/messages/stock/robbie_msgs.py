"""What Robbie-MP says itself, where ROS has no message for it."""

from typing import Any, ClassVar, Literal

from robbie_mp.messages.calls import Feedback, Goal, Reply, Request, Result
from robbie_mp.messages.declaration import Upgrade
from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.flaws import MAX_MAGNITUDE, Flaw, beyond, elements_beyond, outside, unlike_lengths
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import Array, float32, float64, uint8, uint32, uint64
from robbie_mp.messages.stock.builtin_interfaces import Duration, Time
from robbie_mp.messages.stock.geometry_msgs import Point, Pose, PoseStamped
from robbie_mp.messages.stock.nav_msgs import Path
from robbie_mp.messages.stock.sensor_msgs import Image
from robbie_mp.messages.stock.std_msgs import Header
from robbie_mp.messages.stock.vision_msgs import BoundingBox2D


class ModuleState(Message, name="robbie_msgs/msg/ModuleState", version=1):
    """The supervisor saw a module change its state."""

    stamp: Time = DEFAULT
    module: str = DEFAULT  # its name in the profile
    state: str = DEFAULT  # STARTING, RUNNING, BACKOFF, FAILED or STOPPED
    incarnation: uint64 = DEFAULT  # counts the module's processes, from 1
    pid: uint32 = DEFAULT  # of its process; 0 if it has none
    restarts: uint32 = DEFAULT  # so far in this run
    reason: str = DEFAULT  # why it changed, in plain words


class SettingChange(Message, name="robbie_msgs/msg/SettingChange", version=1):
    """Change a setting of the module whose name is the topic."""

    request: uint64 = DEFAULT  # a number that the answer repeats
    setting: str = DEFAULT
    value: str = DEFAULT  # in YAML


class SettingChanged(Message, name="robbie_msgs/msg/SettingChanged", version=1):
    """A module's answer to a SettingChange."""

    request: uint64 = DEFAULT
    module: str = DEFAULT
    setting: str = DEFAULT
    value: str = DEFAULT  # what it is now
    error: str = DEFAULT  # why it was not changed; '' if it was


class CallRefusal(Message, name="robbie_msgs/msg/CallRefusal", version=1):
    """A server answers a request, or a goal, with a reason instead of a reply; the topic names the client."""

    call: uint64 = DEFAULT  # that of the request
    reason: str = DEFAULT  # in plain words


class GoalCancel(Message, name="robbie_msgs/msg/GoalCancel", version=1):
    """A client no longer wants its goal; the topic names the server's module."""

    call: uint64 = DEFAULT  # that of the goal
    reason: str = DEFAULT  # in plain words


class GoalEnd(Message, name="robbie_msgs/msg/GoalEnd", version=1):
    """A goal has ended without a result; the topic names the client."""

    CANCELLED: ClassVar[uint8] = 0  # its client cancelled it
    ABORTED: ClassVar[uint8] = 1  # the server cannot reach it
    PREEMPTED: ClassVar[uint8] = 2  # another goal took its place

    call: uint64 = DEFAULT  # that of the goal
    outcome: uint8 = CANCELLED
    reason: str = DEFAULT  # in plain words


class CallsQuestion(Message, name="robbie_msgs/msg/CallsQuestion", version=1):
    """A client asks what became of its calls; the topic names the server's module.

    The server gets it after the requests that were sent before.
    """

    calls: Array[uint64] = DEFAULT


class CallsAnswer(Message, name="robbie_msgs/msg/CallsAnswer", version=1):
    """A server answers a CallsQuestion, after the replies that it has sent; the topic names the client."""

    calls: Array[uint64] = DEFAULT  # those of the question
    pending: Array[uint64] = DEFAULT  # those of them that it still works on; the others are over, or lost


class Tick(Message, name="robbie_msgs/msg/Tick", version=1):
    """Time for a tick of the module whose name is the topic, in a run in lockstep."""

    due: Time = DEFAULT


class DeviceState(Message, name="robbie_msgs/msg/DeviceState", version=1):
    """Whether a device can be used; the topic names its module. Its driver connects it again by itself."""

    header: Header = DEFAULT
    port: str = DEFAULT  # where the device is, as "/dev/robbie/laser-front"
    state: str = DEFAULT  # CONNECTED or DISCONNECTED
    reason: str = DEFAULT  # why it is DISCONNECTED, in plain words
    connections: uint64 = DEFAULT  # how often it was found and started since the module started
    losses: uint64 = DEFAULT  # how often it was lost after that
    damaged: uint64 = DEFAULT  # frames that were damaged on the way


MAX_COMMANDED_M_PER_S = 100.0
MAX_COMMANDED_RAD_PER_S = 100.0
MAX_VALID_FOR_S = 1.0
"""Longest time for which a command moves anything: so long may it go on when nobody commands any more."""


def invalid_for(valid_for: Duration) -> Flaw | None:
    """Return whether a command is valid for too long, or for less than no time."""
    if 0.0 <= valid_for.seconds <= MAX_VALID_FOR_S:
        return None
    return Flaw("valid_for", valid_for.seconds, f"0 to {MAX_VALID_FOR_S:g} s; send commands again and again")


def _rests_on_its_stamp(fields: dict[str, Any]) -> dict[str, Any]:
    """Take the time of the decision for that of the measurements: version 1 did not tell them apart."""
    return {**fields, "based_on": fields["header"]["stamp"]}


class DriveCommand(
    Message,
    name="robbie_msgs/msg/DriveCommand",
    version=2,
    upgrades={
        1: Upgrade(lambda fields: {**_rests_on_its_stamp(fields), "unguarded": False}),
    },
    checked=True,
):
    """Drive at a velocity, for a while: the device stops when `valid_for` passes without a newer command.

    The device also stops when `based_on` is too old: a new command that rests on old measurements is a blind
    one. A command to stand (both speeds 0) needs neither.
    """

    header: Header = DEFAULT  # stamp: when it was decided
    linear_m_per_s: float64 = DEFAULT  # forward
    angular_rad_per_s: float64 = DEFAULT  # counter-clockwise seen from above
    valid_for: Duration = DEFAULT
    based_on: Time = DEFAULT  # stamp of the oldest measurement, or operator's input, that it rests on
    unguarded: bool = DEFAULT  # True: the operator drives on purpose where the guard would stop the robot

    def flaw(self) -> Flaw | None:
        """Return a velocity that is not finite, or a validity that is too long."""
        return (
            beyond(self, MAX_COMMANDED_M_PER_S, "linear_m_per_s")
            or beyond(self, MAX_COMMANDED_RAD_PER_S, "angular_rad_per_s")
            or invalid_for(self.valid_for)
        )


class ControlState(Message, name="robbie_msgs/msg/ControlState", version=1, latched=True):
    """Who controls the robot's motion. The base publishes it on topic `control` when it changes."""

    AUTO: ClassVar[uint8] = 0  # modules drive the robot
    MANUAL: ClassVar[uint8] = 1  # an operator drives; modules are not obeyed
    HOLD: ClassVar[uint8] = 2  # the robot stands until an operator drives, or orders AUTO by `SetControl`

    header: Header = DEFAULT  # stamp: when it changed
    mode: uint8 = AUTO
    who: str = DEFAULT  # the module that caused the change; '' at the start
    reason: str = DEFAULT  # such as "the operator let go"


class ControlSet(Reply, name="robbie_msgs/srv/SetControl_Response", version=1):
    """The robot is controlled in this way from now on."""

    mode: uint8 = DEFAULT  # constant of `ControlState`


class SetControl(Request[ControlSet], name="robbie_msgs/srv/SetControl_Request", version=1):
    """Order the robot to go on by itself (AUTO), or to stand until it is ordered to go on (HOLD).

    The base refuses AUTO while the emergency stop is engaged. MANUAL cannot be ordered: it begins with the
    first command by hand.
    """

    mode: uint8 = ControlState.HOLD
    reason: str = DEFAULT


class EmergencyStop(Message, name="robbie_msgs/msg/EmergencyStop", version=1):
    """Stop the drive at once and keep it stopped, or let it drive again.

    On topic `emergency_stop` it is a request; on `emergency_stop_state` the base tells what is the case.
    """

    header: Header = DEFAULT
    engaged: bool = DEFAULT  # False: commands that come from now on are followed again
    reason: str = DEFAULT  # in plain words


class Bumper(Message, name="robbie_msgs/msg/Bumper", version=1):
    """Which parts of the robot's bumper touch something."""

    header: Header = DEFAULT
    pressed: list[str] = DEFAULT  # names of the parts, as "front_left"; empty: nothing is touched


MAX_JOINT_POSITION = 1e6
"""Maximum position of a joint, in rad or m."""


class PanTiltCommand(
    Message,
    name="robbie_msgs/msg/PanTiltCommand",
    version=2,
    upgrades={
        1: Upgrade(lambda fields: {**_rests_on_its_stamp(fields), "valid_for": {"sec": 1, "nanosec": 0}})
    },
    checked=True,
):
    """Look in a direction; the joints go there as fast as they can, and no farther than they can.

    The unit follows it only if it arrives within `valid_for` and rests on nothing too old. Then it keeps the
    direction.
    """

    header: Header = DEFAULT  # stamp: when it was decided
    pan_rad: float64 = DEFAULT  # to the left of straight ahead
    tilt_rad: float64 = DEFAULT  # below the horizon (right-handed about the axis to the left)
    valid_for: Duration = DEFAULT  # time within which it must arrive
    based_on: Time = DEFAULT  # stamp of the oldest measurement, or operator's input, that it rests on

    def flaw(self) -> Flaw | None:
        """Return a direction that is not finite, or a validity that is too long."""
        return beyond(self, MAX_JOINT_POSITION, "pan_rad", "tilt_rad") or invalid_for(self.valid_for)


class JointCommand(
    Message,
    name="robbie_msgs/msg/JointCommand",
    version=3,
    upgrades={
        1: Upgrade(_rests_on_its_stamp),
        2: Upgrade(lambda fields: {**fields, "by_hand": False}),
    },
    checked=True,
):
    """Move joints to positions. When `valid_for` passes without a newer command, the device lets them go."""

    header: Header = DEFAULT  # stamp: when it was decided
    name: list[str] = DEFAULT  # of the joints that move; the others keep their goals
    position: Array[float64] = DEFAULT  # (joints,) rad or m
    valid_for: Duration = DEFAULT
    based_on: Time = DEFAULT  # stamp of the oldest measurement, or operator's input, that it rests on
    by_hand: bool = DEFAULT  # True: an operator moves them; modules are not obeyed meanwhile

    def flaw(self) -> Flaw | None:
        """Return whether a joint has no finite position, or the validity is too long."""
        return (
            unlike_lengths(self, "name", "position")
            or elements_beyond(self, MAX_JOINT_POSITION, "position")
            or invalid_for(self.valid_for)
        )


class JointLimits(Message, name="robbie_msgs/msg/JointLimits", version=1):
    """The joints that a module moves by `JointCommand` on the same topic, and how far they go."""

    name: list[str] = DEFAULT
    lower: Array[float64] = DEFAULT  # (joints,) rad or m
    upper: Array[float64] = DEFAULT  # (joints,) rad or m

    def flaw(self) -> Flaw | None:
        """Return whether a joint has no limits. They may be infinite, and NaN if they are not known."""
        return unlike_lengths(self, "name", "lower", "upper")


class LightsState(Message, name="robbie_msgs/msg/LightsState", version=1):
    """How bright the lights of a module are."""

    header: Header = DEFAULT
    name: list[str] = DEFAULT
    brightness: Array[float64] = DEFAULT  # (lights,) from 0, dark, to 1, full
    can_dim: bool = DEFAULT  # False: they are either dark or full

    def flaw(self) -> Flaw | None:
        """Return whether a light has no brightness, or one that is not finite."""
        return unlike_lengths(self, "name", "brightness") or elements_beyond(self, 1.0, "brightness")


class LightSet(Reply, name="robbie_msgs/srv/SetLight_Response", version=1):
    """The light shines so from now on."""

    brightness: float64 = DEFAULT  # from now on: 1 for each wish above 0 if the light cannot be dimmed


class SetLight(Request[LightSet], name="robbie_msgs/srv/SetLight_Request", version=1):
    """Let a light shine. The topic is the name of the module whose light it is."""

    name: str = DEFAULT  # of the light
    brightness: float64 = DEFAULT  # from 0, dark, to 1, full

    def flaw(self) -> Flaw | None:
        """Return a brightness that no light has."""
        return outside(self, 0.0, 1.0, "brightness")


class SimulatedWorld(Message, name="robbie_msgs/msg/SimulatedWorld", version=1):
    """A change of a simulated world, for all simulated devices."""

    header: Header = DEFAULT
    obstacles: Array[uint32] = DEFAULT  # which of the arena's appearing obstacles are there now


class LocalizationState(Message, name="robbie_msgs/msg/LocalizationState", version=1):
    """How well the robot knows where it is on a given map."""

    header: Header = DEFAULT
    converged: bool = DEFAULT  # False: the pose is a guess among several
    spread_m: float64 = DEFAULT  # standard deviation of the position
    spread_rad: float64 = DEFAULT  # standard deviation of the heading
    agreement: float64 = DEFAULT  # share of the last scan's returns that lie on the map's obstacles, 0 … 1
    particles: uint32 = DEFAULT  # hypotheses kept at present

    def flaw(self) -> Flaw | None:
        """Return a number that is not finite."""
        return beyond(self, MAX_MAGNITUDE, "spread_m", "spread_rad", "agreement")


class MappingState(Message, name="robbie_msgs/msg/MappingState", version=1):
    """How well the robot knows where it is on the map that it makes, and what of the map is in doubt."""

    header: Header = DEFAULT  # frame_id: of the map
    certain: bool = DEFAULT  # False: scans do not fit the map, and the pose is odometry's guess
    spread_m: float64 = DEFAULT  # standard deviation of the position, seen from where the map began
    spread_rad: float64 = DEFAULT  # standard deviation of the heading
    covariance: Array[float64, Literal[9]] = DEFAULT  # of x, y (m) and heading (rad), row by row
    gaps_open: uint32 = DEFAULT  # parts of the map that only odometry joins to its beginning
    share_beyond_gaps: float64 = DEFAULT  # of the map's scans, the share in those parts, 0 … 1

    def flaw(self) -> Flaw | None:
        """Return a number that is not finite, a negative deviation, or a share outside 0 to 1."""
        return (
            outside(self, 0.0, MAX_MAGNITUDE, "spread_m", "spread_rad")
            or elements_beyond(self, MAX_MAGNITUDE, "covariance")
            or outside(self, 0.0, 1.0, "share_beyond_gaps")
        )


class NavigationFeedback(Feedback, name="robbie_msgs/action/NavigateTo_Feedback", version=1):
    """How far the robot is on its way to a goal; sent on each change and at intervals."""

    state: str = DEFAULT  # such as DRIVE, ALIGN, BACK_UP, STOPPED_NO_LASER, EMERGENCY_STOP
    reason: str = DEFAULT  # why it is in that state, in plain words
    distance_left_m: float64 = DEFAULT  # along the planned path; -1: there is none

    def flaw(self) -> Flaw | None:
        """Return a distance that is not finite."""
        return beyond(self, MAX_MAGNITUDE, "distance_left_m")


class NavigationResult(Result, name="robbie_msgs/action/NavigateTo_Result", version=1):
    """The robot stands at the goal."""

    duration_s: float64 = DEFAULT  # since the goal was accepted


def _without_place(fields: dict[str, Any]) -> dict[str, Any]:
    """Name no place: version 1 always gave a pose."""
    return {**fields, "place": ""}


class NavigateTo(
    Goal[NavigationFeedback, NavigationResult],
    name="robbie_msgs/action/NavigateTo_Goal",
    version=2,
    upgrades={
        1: Upgrade(_without_place),
    },
):
    """Drive to a pose or a named place, around obstacles. A newer goal takes the place of the older one."""

    pose: PoseStamped = DEFAULT  # frame_id: map, or empty
    place: str = DEFAULT  # name of a place of MapAnnotations, which then gives the pose; '': the pose above


class PathPlanned(Reply, name="robbie_msgs/srv/PlanPath_Response", version=1):
    """A path on which the robot can drive, by what it knows now."""

    path: Path = DEFAULT  # from the robot to the goal


class PlanPath(Request[PathPlanned], name="robbie_msgs/srv/PlanPath_Request", version=1):
    """Plan the path to a goal, and do not drive it. It is refused if no path leads there."""

    pose: PoseStamped = DEFAULT  # frame_id: map, or empty
    seen_from: list[Point] = DEFAULT  # place of the camera that saw the goal; nothing may be between

    def flaw(self) -> Flaw | None:
        """Return whether the goal was seen from several places."""
        count = len(self.seen_from)
        return Flaw("seen_from", count, "one place, or none") if count > 1 else None


class NavigationCancelled(Reply, name="robbie_msgs/srv/CancelNavigation_Response", version=1):
    """The robot has been told to stop, and has no goal any more of those that were to be cancelled."""

    client: str = DEFAULT  # the module whose goal was cancelled; '': there was none


class CancelNavigation(
    Request[NavigationCancelled], name="robbie_msgs/srv/CancelNavigation_Request", version=1
):
    """Stop, and end the goal, even if another module or an earlier process has sent it."""

    client: str = DEFAULT  # the module whose goals are meant; '': all modules
    reason: str = DEFAULT  # in plain words


class Frontiers(Message, name="robbie_msgs/msg/Frontiers", version=1):
    """Where a map ends: pieces of the border between free and unknown space."""

    MAX_PIECES: ClassVar[uint8] = 64  # in one message

    header: Header = DEFAULT  # frame_id: of the map
    middles: list[Point] = DEFAULT  # m, the longest first
    lengths_m: Array[float32] = DEFAULT  # of each

    def flaw(self) -> Flaw | None:
        """Return whether a piece has no length, or one that is not finite."""
        return unlike_lengths(self, "middles", "lengths_m") or elements_beyond(
            self, MAX_MAGNITUDE, "lengths_m"
        )


class PointOfInterest(Message, name="robbie_msgs/msg/PointOfInterest", version=1):
    """A place that matters to the robot or its operator."""

    name: str = DEFAULT  # such as "home"
    pose: Pose = DEFAULT


class PointsOfInterest(Message, name="robbie_msgs/msg/PointsOfInterest", version=1):
    """All places that matter to the sender now; each message takes the place of the last one on its topic."""

    header: Header = DEFAULT  # frame_id: of the map
    points: list[PointOfInterest] = DEFAULT


class NoGoArea(Message, name="robbie_msgs/msg/NoGoArea", version=1):
    """A part of the map that the robot must not enter: a polygon."""

    name: str = DEFAULT
    corners: list[Point] = DEFAULT  # m, map frame, in order; z is ignored


class MapAnnotations(Message, name="robbie_msgs/msg/MapAnnotations", version=1):
    """All that people have drawn on a map; each message takes the place of the last one."""

    header: Header = DEFAULT  # frame_id: of the map
    map_name: str = DEFAULT  # file of the map; '': a map that the robot makes now
    revision: uint32 = DEFAULT  # one more with each change
    no_go: list[NoGoArea] = DEFAULT
    places: list[PointOfInterest] = DEFAULT
    can_undo: bool = DEFAULT  # whether UndoMapAnnotation has a change to take back


class MapAnnotated(Reply, name="robbie_msgs/srv/AnnotateMap_Response", version=1):
    """The map is annotated as asked, and the annotations are saved."""

    revision: uint32 = DEFAULT  # of the annotations


class AnnotateMap(Request[MapAnnotated], name="robbie_msgs/srv/AnnotateMap_Request", version=1):
    """Draw on the map: first remove, then add. All of it is one change, and all or nothing is done."""

    remove: list[str] = DEFAULT  # names of areas and places
    no_go: list[NoGoArea] = DEFAULT  # an area of the same name is replaced; '' gets a name
    places: list[PointOfInterest] = DEFAULT  # a place of the same name is replaced


class MapAnnotationUndone(Reply, name="robbie_msgs/srv/UndoMapAnnotation_Response", version=1):
    """The annotations are as they were before the last change."""

    revision: uint32 = DEFAULT  # of the annotations; still one more than before


class UndoMapAnnotation(
    Request[MapAnnotationUndone], name="robbie_msgs/srv/UndoMapAnnotation_Request", version=1
):
    """Take back the last change of the map's annotations. There may be several; the last goes first."""


class TaughtNames(Message, name="robbie_msgs/msg/TaughtNames", version=1):
    """All that a module has been taught to recognize, on the topic of its services, such as `objects`."""

    names: list[str] = DEFAULT
    examples: Array[uint32] = DEFAULT  # of each name

    def flaw(self) -> Flaw | None:
        """Return whether some names have a number of examples, and others have none."""
        return unlike_lengths(self, "names", "examples", or_empty=True)


class RecognitionTaught(Reply, name="robbie_msgs/srv/TeachRecognition_Response", version=1):
    """It is learnt and saved."""

    examples: uint32 = DEFAULT  # of this name


class TeachRecognition(
    Request[RecognitionTaught], name="robbie_msgs/srv/TeachRecognition_Request", version=1
):
    """Learn how a thing looks. The topic says what kind of thing it is: `objects` or `persons`."""

    name: str = DEFAULT  # of one that is known, for a further example; or a new one
    image: Image = DEFAULT  # in which it is; with it, the request holds all that is needed, however old it is
    box: BoundingBox2D = DEFAULT  # where it is in the image
    image_topic: str = DEFAULT  # of the camera, such as "camera"


class RecognitionForgotten(Reply, name="robbie_msgs/srv/ForgetRecognition_Response", version=1):
    """It is forgotten, and that is saved."""


class ForgetRecognition(
    Request[RecognitionForgotten], name="robbie_msgs/srv/ForgetRecognition_Request", version=1
):
    """Forget a thing that was taught. The topic says of which kind."""

    name: str = DEFAULT


class Mark(Message, name="robbie_msgs/msg/Mark", version=1):
    """A moment that a user marked, to find it again in the log."""

    header: Header = DEFAULT  # stamp: the moment
    text: str = DEFAULT  # what for


class Clip(Message, name="robbie_msgs/msg/Clip", version=1):
    """What the black box does with a clip: the messages around something that happened."""

    OPEN: ClassVar[uint8] = 0  # it still grows
    WRITTEN: ClassVar[uint8] = 1  # it is on the disk
    MISSED: ClassVar[uint8] = 2  # it is not on the disk, or not whole

    stamp: Time = DEFAULT
    folder: str = DEFAULT  # a log
    state: uint8 = OPEN
    triggers: list[str] = DEFAULT  # what happened, in plain words, in this order; a mark has its text
    bytes: uint64 = DEFAULT  # of the clip, when it is on the disk
    reason: str = DEFAULT  # why something of it is missing
