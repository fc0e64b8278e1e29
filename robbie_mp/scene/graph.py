"""The scene graph: a tree of frames, each with the history of its pose over the last seconds."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

from robbie_mp.base.suggest import did_you_mean
from robbie_mp.messages.frames import without_slash
from robbie_mp.scene.body import Body, PlacedNode, fixed_node, floating_node, jointed_node, root_node
from robbie_mp.scene.errors import (
    Disconnected,
    DuplicateNode,
    MissingParent,
    NotAPose,
    NotMovable,
    UnknownNode,
)
from robbie_mp.scene.history import History, circular, linear
from robbie_mp.scene.node import Joint, JointType, Mimic, Node
from robbie_mp.scene.rigid_transform import Pose7, RigidTransform, compose, interpolate, relative
from robbie_mp.scene.tree_check import follow, is_joint, parents_first, tree_problems

HISTORY_S = 10.0
HISTORY_LIMIT = 5000


class SceneGraph:
    """A tree of nodes; it gives you the pose of any node in the frame of another at a time.

        graph = SceneGraph([
            Node("map"),
            Node("base_link", "map", joint=Joint(JointType.FLOATING)),
            Node("laser", "base_link", RigidTransform.of((0.2, 0.0, 0.1))),
        ])
        graph.move("base_link", time_ns, RigidTransform.of((1.0, 2.0, 0.0)))
        X_ML = graph.pose("map", "laser", time_ns)

    A slash before a name, as ROS 1 has it, does not count: `/map` is `map`.

    Frames without a joint between them form one rigid body. A query composes one pose for each joint on the
    path, so its cost grows with the number of joints, not with the number of nodes.

    Args:
        nodes: the nodes, in any order. There may be several trees, but no poses between them.
        history_s: how much of each joint's past is remembered, in s.
        history_limit: most values that are remembered for each joint.

    Raises:
        DuplicateNode, MissingParent, NodeCycle, BadJoint: the nodes do not form trees; the first problem.
    """

    def __init__(
        self, nodes: Iterable[Node] = (), *, history_s: float = HISTORY_S, history_limit: int = HISTORY_LIMIT
    ):
        self._keep = (history_s, history_limit)
        self._nodes: dict[str, PlacedNode] = {}
        self._joints: dict[str, tuple[Joint, History[float]]] = {}
        self._floating: dict[str, History[Pose7]] = {}
        nodes = list(nodes)
        for _, error in tree_problems(nodes):
            raise error
        joints = {node.joint.name: node.joint for node in nodes if node.joint is not None}
        leaders: dict[str, Mimic] = {}
        for node in filter(is_joint, nodes):
            self._add_joint(node)
        for node in parents_first(nodes):
            self._place(_following(node, joints, leaders))

    # -- nodes and joints ------------------------------------------------------------------------------

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and without_slash(name) in self._nodes

    def __iter__(self) -> Iterator[Node]:
        """Iterate over the nodes, each after its parent."""
        return (placed.node for placed in self._nodes.values())

    def __len__(self) -> int:
        return len(self._nodes)

    def node(self, name: str) -> Node:
        """Return the node of a name.

        Raises:
            UnknownNode: there is none.
        """
        return self._find(name).node

    def joint(self, name: str) -> Joint:
        """Return the joint of a name.

        Raises:
            UnknownNode: there is no such joint, or it follows another joint.
        """
        return self._find_joint(name)[0]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that do not follow another joint."""
        return tuple(self._joints)

    def newest_ns(self, name: str) -> int | None:
        """Return the newest time (ns) of a node's pose in its parent; None if there is none, or it is fixed.

        Raises:
            UnknownNode: there is none.
        """
        placed = self._find(name)
        history = placed.body.history
        return history.newest_ns if history is not None and placed.node.joint is not None else None

    # -- changes ---------------------------------------------------------------------------------------

    def add(self, node: Node) -> None:
        """Add a node whose parent is in the graph.

        Raises:
            DuplicateNode: the graph has a node or joint of this name.
            MissingParent: its parent, or the joint that it follows, is not in the graph.
        """
        if node.name in self._nodes:
            raise DuplicateNode(f"node {node.name!r} exists already")
        if node.parent is not None and node.parent not in self._nodes:
            hint = did_you_mean(node.parent, self._nodes)
            raise MissingParent(f"the parent of node {node.name!r}, {node.parent!r}, does not exist{hint}")
        if is_joint(node):
            self._add_joint(node)
        joints = {each.joint.name: each.joint for each in (*self, node) if each.joint is not None}
        self._place(_following(node, joints, {}))

    def hang(self, node: Node) -> None:
        """Attach a node to another parent or in another way: `node` replaces the node of the same name.

        Its children move with it. If it is floating, its history is deleted.

        Raises:
            UnknownNode: there is no node of this name.
            NotMovable: the old or the new node has a joint; such nodes cannot be moved to another parent.
            MissingParent, NodeCycle: the node cannot be attached there.
        """
        before = self._find(node.name).node
        for each in (before, node):
            if each.joint is not None and each.joint.type is not JointType.FLOATING:
                raise NotMovable(f"node {node.name!r} cannot get another parent: it moves by a joint")
        nodes = [node if placed is before else placed for placed in self]
        for _, error in tree_problems(nodes):
            raise error
        self._floating.pop(node.name, None)
        self._nodes.clear()
        for each in parents_first(nodes):
            self._place(each)

    def move(self, name: str, time_ns: int, pose: RigidTransform) -> None:
        """Set the pose of a floating node in its parent (X_PN) at a time, in ns.

        Raises:
            UnknownNode: there is no node of this name.
            NotMovable: it is not floating.
            TooOld: the time lies before the remembered history.
        """
        history = self._floating.get(without_slash(name))
        if history is None:
            kind = self._find(name).node.joint_type
            raise NotMovable(
                f"node {name!r} is {kind}, not floating; poses can be set for floating nodes only"
            )
        history.add(time_ns, pose)

    def set_joint(self, name: str, time_ns: int, position: float) -> None:
        """Set the position (rad or m) of a joint at a time, in ns. Its limits are not enforced.

        Raises:
            UnknownNode: there is no such joint, or it follows another joint.
            NotAPose: the position is not finite.
            TooOld: the time lies before the remembered history.
        """
        _, history = self._find_joint(name)
        if not math.isfinite(position):
            raise NotAPose(f"joint {name!r}: a position must be a finite number, not {position}")
        history.add(time_ns, position)

    def forget(self) -> None:
        """Delete the history of everything that moves, as after a jump of time; the nodes stay."""
        for _, joint in self._joints.values():
            joint.forget()
        for floating in self._floating.values():
            floating.forget()

    # -- queries ---------------------------------------------------------------------------------------

    def pose(self, a: str, b: str, time_ns: int | None = None) -> RigidTransform:
        """Return X_AB, the pose of node `b` in the frame of node `a`.

        Args:
            a: the node in whose frame the pose is expressed.
            b: the node whose pose is returned.
            time_ns: the time; None for the newest time at which every joint between them is known.

        Raises:
            UnknownNode: one of the nodes does not exist.
            Disconnected: they are in different trees.
            NeverPlaced: a joint between them has no position or pose yet.
            TooOld, TooNew: for this time, a joint between them is no longer, or not yet, known.
        """
        placed_a, placed_b = self._find(a), self._find(b)
        if time_ns is None:
            time_ns = self.newest_common_ns(a, b)
        of_a, of_b = placed_a.body, placed_b.body
        if of_a.root != of_b.root:
            self._refuse_disconnected(placed_a, placed_b)
        pose_a, pose_b = placed_a.place, placed_b.place
        # Go up from both nodes, always from the deeper one, until the paths meet.
        while of_a is not of_b:
            if of_b.depth >= of_a.depth:
                pose_b = compose(of_b.pose_at(time_ns), pose_b)
                of_b = of_b.parent  # type: ignore[assignment]  # only a root has none, and there they meet
            else:
                pose_a = compose(of_a.pose_at(time_ns), pose_a)
                of_a = of_a.parent  # type: ignore[assignment]
        return RigidTransform._make(relative(pose_a, pose_b))

    def newest_common_ns(self, a: str, b: str) -> int:
        """Return the newest time (ns) for which X_AB is known; 0 if it never changes.

        Raises:
            UnknownNode, Disconnected, NeverPlaced: as for `pose`.
        """
        newest = [history.require_newest_ns() for history in self._between(self._find(a), self._find(b))]
        return min(newest, default=0)

    def _between(self, a: PlacedNode, b: PlacedNode) -> Iterator[History[Pose7] | History[float]]:
        if a.body.root != b.body.root:
            self._refuse_disconnected(a, b)
        one: Body | None = a.body
        other: Body | None = b.body
        while one is not other:
            if one is None or (other is not None and other.depth > one.depth):
                one, other = other, one
            assert one is not None and one.history is not None
            yield one.history
            one = one.parent

    def _refuse_disconnected(self, a: PlacedNode, b: PlacedNode) -> None:
        raise Disconnected(
            f"nodes {a.node.name!r} and {b.node.name!r} are not connected: "
            f"one is below {a.body.root!r}, the other below {b.body.root!r}"
        )

    # -- construction ----------------------------------------------------------------------------------

    def _find(self, name: str) -> PlacedNode:
        placed = self._nodes.get(name) or self._nodes.get(without_slash(name))
        if placed is None:
            raise UnknownNode(f"there is no node {name!r}", name, self._nodes)
        return placed

    def _find_joint(self, name: str) -> tuple[Joint, History[float]]:
        found = self._joints.get(name)
        if found is None:
            raise UnknownNode(f"there is no joint {name!r}", name, self._joints)
        return found

    def _add_joint(self, node: Node) -> None:
        joint = node.joint
        assert joint is not None
        if joint.name in self._joints:
            raise DuplicateNode(f"joint {joint.name!r} exists already")
        between = circular if joint.type is JointType.CONTINUOUS else linear
        history = History(f"joint {joint.name!r}", between, *self._keep)
        self._joints[joint.name] = (joint, history)

    def _place(self, node: Node) -> None:
        joint = node.joint
        if node.parent is None:
            placed = root_node(node)
        elif joint is None:
            placed = fixed_node(node, self._nodes[node.parent])
        elif joint.type is JointType.FLOATING:
            made = History(f"the pose of node {node.name!r}", interpolate, *self._keep)
            history = self._floating.setdefault(node.name, made)
            placed = floating_node(node, self._nodes[node.parent], history)
        else:
            leader = joint.mimic.joint if joint.mimic else joint.name
            placed = jointed_node(node, joint, self._nodes[node.parent], self._joints[leader][1])
        self._nodes[node.name] = placed


def _following(node: Node, joints: dict[str, Joint], leaders: dict[str, Mimic]) -> Node:
    """Return a node whose joint follows, if any, one that follows no other."""
    joint = node.joint
    if joint is None or joint.mimic is None:
        return node
    return replace(node, joint=follow(joint, joints, leaders))
