"""Makes URDFs as they are found in the wild, each with the robot that the specification says it is.

The kinematics are written from the specification alone (https://wiki.ros.org/urdf/XML/joint), as an oracle.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
NUMBERS = st.floats(-3.0, 3.0).map(lambda number: round(number, 4))
TRIPLES = st.tuples(NUMBERS, NUMBERS, NUMBERS)
DIRECTIONS = TRIPLES.filter(lambda each: math.hypot(*each) > 0.1)
SPACES = st.sampled_from([" ", "  ", "\t", "\n "])
HARMLESS = [
    "<transmission name='t'><joint name='j0'/><actuator name='m'/></transmission>",
    "<gazebo reference='l0'><material>Gazebo/Red</material><link name='l0'/></gazebo>",
    "<material name='grey'><color rgba='0 0 0 1'/></material>",
    "<!-- joint j0 -->",
]
OF_LINKS = [
    "<visual><geometry><capsule radius='1' length='2'/></geometry></visual>",
    "<visual><geometry><mesh filename='package://robot/a.dae' scale='1 1 1'/></geometry></visual>"
    "<visual><geometry><sphere radius='1'/></geometry></visual>",
    "<inertial><mass value='1'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial>",
]
OF_JOINTS = [
    "<safety_controller k_velocity='1' soft_lower_limit='0'/>",
    "<calibration rising='0.1'/>",
    "<dynamics damping='1' friction='0'/>",
]
PROLOGS = [
    "",
    "\ufeff",
    "<?xml version='1.0'?>\n",
    "<?xml version='1.0' encoding='UTF-8'?><!-- a -->\n",
    " \n\t",
]


@dataclass
class OddJoint:
    """A joint, as the specification describes it."""

    kind: str
    parent: int
    xyz: tuple[float, ...]
    turn: Matrix
    axis: tuple[float, ...]
    leader: int | None = None
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass
class OddRobot:
    """A robot: joint i moves link i; link 0 is the root."""

    text: str = ""
    joints: dict[int, OddJoint] = field(default_factory=dict)

    def position(self, number: int, positions: dict[int, float]) -> float:
        """The position of a joint: its own, or that which its leader tells."""
        joint = self.joints[number]
        if joint.leader is None:
            return positions[number]
        return joint.multiplier * self.position(joint.leader, positions) + joint.offset

    def pose(self, number: int, positions: dict[int, float]) -> Matrix:
        """The pose of a link in the root: (4, 4)."""
        if number == 0:
            return np.eye(4)
        joint = self.joints[number]
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = joint.turn, joint.xyz
        motion = np.eye(4)
        if joint.kind != "fixed":
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            q = self.position(number, positions)
            if joint.kind == "prismatic":
                motion[:3, 3] = q * axis
            else:
                motion[:3, :3] = about(axis, q)
        return np.asarray(self.pose(joint.parent, positions) @ local @ motion)


def about(axis: Matrix, angle: float) -> Matrix:
    """A rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)


def fixed_axes(rpy: tuple[float, ...]) -> Matrix:
    """Roll about x, then pitch about y, then yaw about z, all of the parent."""
    x, y, z = np.eye(3)
    return about(z, rpy[2]) @ about(y, rpy[1]) @ about(x, rpy[0])


@st.composite
def odd_robots(draw: st.DrawFn) -> OddRobot:
    """A robot of up to 8 links."""
    robot, parts = OddRobot(), []
    count = draw(st.integers(2, 8))
    for number in range(count):
        parts.append(f"<link name='l{number}'>{draw(st.sampled_from(['', *OF_LINKS]))}</link>")
    for number in range(1, count):
        parts.append(draw(_joint(robot, number)))
    parts += draw(st.lists(st.sampled_from(HARMLESS), max_size=2, unique=True))
    attributes = "xmlns:xacro='http://www.ros.org/wiki/xacro' name='r' version='1.1'"
    inside = "\n".join(draw(st.permutations(parts)))
    robot.text = f"{draw(st.sampled_from(PROLOGS))}<robot {attributes}>\n{inside}\n</robot>\n"
    return robot


@st.composite
def _joint(draw: st.DrawFn, robot: OddRobot, number: int) -> str:
    kind = draw(st.sampled_from(["fixed", "revolute", "continuous", "prismatic"]))
    parent, axis = (
        draw(st.integers(0, number - 1)),
        draw(DIRECTIONS),
    )
    origin, xyz, turn = draw(_origin())
    joint = robot.joints[number] = OddJoint(kind, parent, xyz, turn, axis)
    parts = [f"<parent link='l{parent}'/>", f"<child link='l{number}'/>", origin]
    if draw(st.booleans()):
        parts.append(f"<axis xyz='{_words(draw, axis)}'/>")
    else:
        joint.axis = (1.0, 0.0, 0.0)
    if kind in ("revolute", "prismatic"):
        parts.append(draw(st.sampled_from(LIMITS)))
    leaders = [other for other, each in robot.joints.items() if each.kind != "fixed" and other != number]
    if kind != "fixed" and leaders and draw(st.booleans()):
        parts.append(draw(_mimic(joint, leaders)))
    parts += draw(st.lists(st.sampled_from(OF_JOINTS), max_size=2, unique=True))
    return f"<joint type='{kind}' name='j{number}'>{''.join(draw(st.permutations(parts)))}</joint>"


LIMITS = [
    "<limit lower='-1' upper='1' effort='-1' velocity='-1'/>",
    "<limit effort='0' velocity='0'/>",
    "<limit lower='-inf' upper='INF' effort='inf' velocity='inf'/>",
    "<limit lower='1' upper='-1'/>",
    "<limit lower='nan' upper='nan' velocity='NaN'/>",
    "<limit upper='+1.e0' lower='-.5' velocity='1E1' effort='1' jerk='3' acceleration='2'/>",
]


@st.composite
def _origin(draw: st.DrawFn) -> tuple[str, tuple[float, ...], Matrix]:
    xyz, rpy = draw(TRIPLES), draw(TRIPLES)
    place = f"xyz='{_words(draw, xyz)}'"
    match draw(st.integers(0, 3)):
        case 0:
            return "", (0.0, 0.0, 0.0), np.eye(3)
        case 1:
            return f"<origin {place}/>", xyz, np.eye(3)
        case 2:
            return f"<origin {place} rpy='{_words(draw, rpy)}'/>", xyz, fixed_axes(rpy)
    axis = draw(DIRECTIONS)
    unit = np.array(axis) / np.linalg.norm(axis)
    half = rpy[0] / 2
    quaternion = (*(math.sin(half) * unit), math.cos(half))
    length = draw(st.sampled_from([1.0, 1.0, 2.0]))
    words = _words(draw, tuple(length * float(part) for part in quaternion))
    return f"<origin {place} quat_xyzw='{words}'/>", xyz, about(unit, 2 * half)


@st.composite
def _mimic(draw: st.DrawFn, joint: OddJoint, leaders: list[int]) -> str:
    joint.leader = draw(st.sampled_from(leaders))
    text = f"<mimic joint='j{joint.leader}'"
    if draw(st.booleans()):
        joint.multiplier = draw(NUMBERS)
        text += f" multiplier='{joint.multiplier}'"
    if draw(st.booleans()):
        joint.offset = draw(NUMBERS)
        text += f" offset='{joint.offset}'"
    return text + "/>"


def _words(draw: st.DrawFn, numbers: tuple[float, ...]) -> str:
    return draw(SPACES).join(map(str, numbers))
