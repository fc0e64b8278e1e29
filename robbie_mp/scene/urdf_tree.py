"""Reads the tree of links and joints of a URDF (https://wiki.ros.org/urdf/XML); xacro files are expanded."""

from pathlib import Path

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.scene.described import Description, make_node
from robbie_mp.scene.errors import SceneFileError
from robbie_mp.scene.node import Joint
from robbie_mp.scene.rigid_transform import IDENTITY, RigidTransform
from robbie_mp.scene.urdf_joint import JointReader
from robbie_mp.scene.urdf_values import UrdfValues
from robbie_mp.scene.xacro import expand, needs_xacro
from robbie_mp.scene.xml_elements import Element, parse_xml, read_content

UNUSED = ("material", "transmission", "gazebo", "sensor", "ros2_control", "visual", "collision", "inertial")
"""Elements of a robot and of its links that say nothing about frames."""


def read_urdf(file: Path) -> Description:
    """Return the nodes that a URDF describes, one for each link with the link's name, and all problems."""
    description = Description(file)
    try:
        describe_robot(description, read_robot(file))
    except SceneFileError as error:
        description.problems.extend(error.problems)
    return description


def read_robot(file: Path) -> Element:
    """Return the root element of a URDF.

    Raises:
        SceneFileError: the file cannot be read, is not XML, or xacro, which it needs, fails or is missing.
    """
    robot = parse_xml(read_content(file), file)
    if needs_xacro(robot):
        return parse_xml(expand(file), Path(f"{file} after xacro"))
    return robot


def describe_robot(description: Description, robot: Element) -> None:
    """Add the nodes of a robot to a description."""
    if robot.tag != "robot":
        description.wrong(f"the root element of a URDF is <robot>, not <{robot.tag:.40}>", robot.place)
        return
    _Robot(UrdfValues(description, robot), robot).describe()


class _Robot:
    def __init__(self, values: UrdfValues, robot: Element) -> None:
        self._values = values
        self._joints = JointReader(values)
        self._robot = robot
        self._joint_of_child: dict[str, Element] = {}
        self._joint_of_name: dict[str, Element] = {}

    def describe(self) -> None:
        links = {self._values.attribute(link, "name"): link for link in self._robot.all("link")}
        self._note_unused(self._robot, ("link", "joint"))
        for joint in self._robot.all("joint"):
            self._note_joint(joint, links)
        moving = {name for name in (self._describe_link(link) for link in self._robot.all("link")) if name}
        self._check_mimics(moving)
        self._check_roots([link for name, link in links.items() if name not in self._joint_of_child])

    def _check_roots(self, roots: list[Element]) -> None:
        if not self._robot.all("link"):
            self._values.wrong(self._robot, "the robot has no <link>")
        for root in roots[1:]:
            self._values.doubt(
                root, "a link that no joint connects to the first root: it is a tree of its own"
            )

    def _note_unused(self, element: Element, used: tuple[str, ...]) -> None:
        for child in element.children:
            if child.tag in UNUSED:
                self._values.leave_out(child, f"<{child.tag}>: a scene graph has frames only")
            elif child.tag not in used:
                hint = did_you_mean(child.tag, (*used, *UNUSED))
                self._values.doubt(child, f"<{element.tag}> has no <{child.tag:.40}> in URDF{hint}")

    def _note_joint(self, joint: Element, links: dict[str, Element]) -> None:
        joint_name = self._values.attribute(joint, "name")
        other = self._joint_of_name.setdefault(joint_name, joint)
        if other is not joint and joint_name:
            text = f"joint {joint_name!r} is described twice, first at {other.place}"
            self._values.wrong(joint, text)
        for role in ("parent", "child"):
            name = self._link_of(joint, role)
            if name and name not in links:
                what = f"joint {joint_name!r}: its {role} {name!r} is not a link"
                self._values.wrong(joint, what + did_you_mean(name, links))
        child = self._link_of(joint, "child")
        before = self._joint_of_child.setdefault(child, joint)
        if before is not joint and child:
            self._values.wrong(joint, f"link {child!r} is the child of two joints, also at {before.place}")

    def _describe_link(self, link: Element) -> str:
        """Add a link; return the name of the joint that moves it, if it has a position."""
        self._note_unused(link, ())
        name = self._values.attribute(link, "name")
        element = self._joint_of_child.get(name)
        if element is None:
            self._node(link, name, None, IDENTITY, None)
            return ""
        origin, joint = self._joints.read(element)
        self._node(element, name, self._link_of(element, "parent"), origin, joint)
        return joint.name if joint is not None else ""

    def _node(
        self, at: Element, name: str, parent: str | None, origin: RigidTransform, joint: Joint | None
    ) -> None:
        make_node(self._values.description, at.place, name, parent, origin, joint)

    def _check_mimics(self, moving: set[str]) -> None:
        """Refuse to follow a joint that has no position: the graph knows only those that have one."""
        at_rest = self._joint_of_name.keys() - moving
        for node, place in self._values.description.nodes:
            mimic = node.joint.mimic if node.joint else None
            if node.joint and mimic and mimic.joint in at_rest:
                kind = self._joint_of_name[mimic.joint].attributes.get("type")
                text = (
                    f"joint {node.joint.name!r} follows {mimic.joint!r}, which is {kind}: it has no position"
                )
                self._values.description.wrong(text, place)

    def _link_of(self, joint: Element, role: str) -> str:
        element = joint.first(role)
        if element is None:
            name = joint.attributes.get("name", "")
            self._values.wrong(joint, f"joint {name!r} has no <{role} link=…>")
            return ""
        return self._values.attribute(element, "link")
