"""The nodes that a file describes, each with its place in the file, and the problems of the file."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from robbie_mp.base.problem import Problem, SourcePlace
from robbie_mp.scene.errors import SceneGraphError
from robbie_mp.scene.node import Joint, Node
from robbie_mp.scene.rigid_transform import RigidTransform

Made = TypeVar("Made")


class Described(NamedTuple):
    """A node, and the place where it is described."""

    node: Node
    place: SourcePlace


class Description:
    """The nodes of a file and of the files that it includes, and all their problems."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.nodes: list[Described] = []
        self.problems: list[Problem] = []

    def wrong(self, text: str, place: SourcePlace) -> None:
        """Note a problem."""
        self.problems.append(Problem(text, place))

    def attempt(self, place: SourcePlace, make: Callable[[], Made], instead: Made) -> Made:
        """Return the result of `make`; if it raises an error, note the problem and return `instead`."""
        try:
            return make()
        except SceneGraphError as error:
            self.wrong(str(error), place)
            return instead

    def include(self, other: "Description", prefix: str, hanger: Described) -> None:
        """Add another file's nodes, with a prefix before all names.

        Args:
            other: the description of the other file.
            prefix: prefix of all names, such as "red/".
            hanger: says where the other file's root is attached; its name is ignored.
        """
        self.problems.extend(other.problems)
        roots = [node for node, _ in other.nodes if node.parent is None]
        if hanger.node.parent is not None and len(roots) > 1:
            names = ", ".join(repr(root.name) for root in roots)
            self.wrong(
                f"{other.file.name} has several roots ({names}); only a tree with one root can be attached",
                hanger.place,
            )
        for node, place in other.nodes:
            made = Described(prefixed(node, prefix), place)
            if node.parent is None and hanger.node.parent is not None:
                made = Described(replace(hanger.node, name=made.node.name), hanger.place)
            self.nodes.append(made)


def prefixed(node: Node, prefix: str) -> Node:
    """Return a node with a prefix before its name and before all names that it refers to."""
    joint = node.joint
    if joint is not None:
        mimic = joint.mimic and replace(joint.mimic, joint=prefix + joint.mimic.joint)
        joint = replace(joint, name=joint.name and prefix + joint.name, mimic=mimic)
    parent = None if node.parent is None else prefix + node.parent
    return replace(node, name=prefix + node.name, parent=parent, joint=joint)


def make_node(
    description: Description,
    place: SourcePlace,
    name: str,
    parent: str | None,
    origin: RigidTransform,
    joint: Joint | None,
) -> None:
    """Add a node to a description; if it is invalid, add a placeholder as a parent for its children."""
    node = description.attempt(place, lambda: Node(name, parent, origin, joint), Node(name or "?", parent))
    description.nodes.append(Described(node, place))
