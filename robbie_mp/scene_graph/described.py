"""What a file says about nodes: each with the place where it says so, and what is wrong with it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from robbie_mp.profile.problem import Place, Problem
from robbie_mp.scene_graph.errors import SceneGraphError
from robbie_mp.scene_graph.node import Joint, Node
from robbie_mp.scene_graph.rigid_transform import RigidTransform

Made = TypeVar("Made")


class Described(NamedTuple):
    """A node, and where it is described."""

    node: Node
    place: Place


class Description:
    """The nodes of one file and of those it includes, and all that is wrong with them."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.nodes: list[Described] = []
        self.problems: list[Problem] = []

    def wrong(self, text: str, place: Place) -> None:
        """Note a problem."""
        self.problems.append(Problem(text, place))

    def attempt(self, place: Place, make: Callable[[], Made], instead: Made) -> Made:
        """Return what `make` makes, or `instead` if that is refused, which is noted."""
        try:
            return make()
        except SceneGraphError as error:
            self.wrong(str(error), place)
            return instead

    def include(self, other: "Description", prefix: str, hanger: Described) -> None:
        """Take over another file's nodes, with a prefix before all names.

        Args:
            other: the description of the other file.
            prefix: such as "red/".
            hanger: how the root of the other hangs here; its own name does not count.
        """
        self.problems.extend(other.problems)
        roots = [node for node, _ in other.nodes if node.parent is None]
        if hanger.node.parent is not None and len(roots) > 1:
            names = ", ".join(repr(root.name) for root in roots)
            self.wrong(
                f"{other.file.name} has several roots ({names}); only one can be hung up", hanger.place
            )
        for node, place in other.nodes:
            made = Described(prefixed(node, prefix), place)
            if node.parent is None and hanger.node.parent is not None:
                made = Described(replace(hanger.node, name=made.node.name), hanger.place)
            self.nodes.append(made)


def prefixed(node: Node, prefix: str) -> Node:
    """Return a node with a prefix before its name and all others that it mentions."""
    joint = node.joint
    if joint is not None:
        mimic = joint.mimic and replace(joint.mimic, joint=prefix + joint.mimic.joint)
        joint = replace(joint, name=joint.name and prefix + joint.name, mimic=mimic)
    parent = None if node.parent is None else prefix + node.parent
    return replace(node, name=prefix + node.name, parent=parent, joint=joint)


def make_node(
    description: Description,
    place: Place,
    name: str,
    parent: str | None,
    origin: RigidTransform,
    joint: Joint | None,
) -> None:
    """Add a node to a description; if it makes no sense, one that children can hang on."""
    node = description.attempt(place, lambda: Node(name, parent, origin, joint), Node(name or "?", parent))
    description.nodes.append(Described(node, place))
