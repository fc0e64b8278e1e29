"""The nodes that a file describes, each with its place, the problems of the file, and what is left out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from robbie_mp.base.balance import MAX_REASONS, OTHER_REASONS, Balance
from robbie_mp.base.problem import Problem, SourcePlace
from robbie_mp.scene.errors import SceneGraphError
from robbie_mp.scene.node import Joint, Node
from robbie_mp.scene.rigid_transform import RigidTransform

Made = TypeVar("Made")


class Described(NamedTuple):
    """A node, and the place where it is described."""

    node: Node
    place: SourcePlace


class SceneNotes:
    """What a reader of scene files left out.

    Args:
        is_strict: raise `LeftOut` for anything that is left out.

    Attributes:
        balance: the elements of the files that are used, and those that are left out by reason.
        warnings: those that change the robot: an invalid limit, a joint of another type.
    """

    def __init__(self, *, is_strict: bool = False) -> None:
        self.balance = Balance(is_strict=is_strict)
        self.warnings: list[str] = []


@dataclass
class Remark:
    """Something that is left out, at its first place."""

    place: SourcePlace
    count: int
    is_warning: bool


class Description:
    """The nodes of a file and of the files that it includes, all their problems, and what is left out."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.nodes: list[Described] = []
        self.problems: list[Problem] = []
        self.remarks: dict[str, Remark] = {}

    def wrong(self, text: str, place: SourcePlace) -> None:
        """Note a problem."""
        self.problems.append(Problem(text, place))

    def leave_out(self, text: str, place: SourcePlace, *, is_warning: bool = False, count: int = 1) -> None:
        """Note that something is left out.

        Args:
            text: what and why, without names, so that a text stands for all of its kind.
            place: where it is.
            is_warning: the robot differs without it.
            count: how often.
        """
        if text not in self.remarks and len(self.remarks) >= MAX_REASONS:
            text = OTHER_REASONS
        remark = self.remarks.setdefault(text, Remark(place, 0, is_warning))
        remark.count += count
        remark.is_warning |= is_warning

    def note(self, notes: SceneNotes) -> None:
        """Add what is used and left out to notes."""
        notes.balance.use(len(self.nodes))
        for text, remark in self.remarks.items():
            if remark.is_warning:
                more = f" (and {remark.count - 1} more)" if remark.count > 1 else ""
                notes.warnings.append(f"{remark.place}: {text}{more}")
            notes.balance.leave_out(f"{text} (first at {remark.place})", remark.count)

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
        for text, remark in other.remarks.items():
            self.leave_out(text, remark.place, is_warning=remark.is_warning, count=remark.count)
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
