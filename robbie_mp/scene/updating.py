"""Applies a robot's motion messages to its scene graph, and records which nodes have moved."""

from collections.abc import Container

from robbie_mp.messages import JointState, Odometry, PoseStamped, TFMessage
from robbie_mp.messages.frames import without_slash
from robbie_mp.scene.conversion import from_pose, from_transform
from robbie_mp.scene.errors import Disconnected, NeverPlaced, SceneGraphError, TooNew
from robbie_mp.scene.graph import SceneGraph
from robbie_mp.scene.rigid_transform import RigidTransform
from robbie_mp.scene.warn_once import WarnOnce


class SceneUpdater:
    """Moves the nodes of a scene graph by messages.

    "base_link" in a message on a topic such as "red/odom" means "red/base_link", if there is such a node.
    A message, or part of one, that cannot be applied is ignored, counted, and reported once.

    Args:
        graph: the graph whose nodes move.
        base: the node that map poses place, without prefix.
        warnings: reports what is ignored.
    """

    def __init__(self, graph: SceneGraph, base: str, warnings: WarnOnce):
        self._graph = graph
        self._base = base
        self._warnings = warnings
        self._nodes_of_joint: dict[str, list[str]] = {name: [] for name in graph.joints}
        self._followers: set[str] = set()
        for node in graph:
            if node.joint is not None and node.joint.mimic is not None:
                self._followers.add(node.joint.name)
                self._nodes_of_joint[node.joint.mimic.joint].append(node.name)
            elif node.joint is not None and node.joint.name:
                self._nodes_of_joint[node.joint.name].append(node.name)
        self._waiting: dict[str, PoseStamped] = {}
        self.moved: dict[tuple[str, int], None] = {}
        """Nodes that have moved since `take_moved` was last called: names, and times (ns)."""
        self.corrections: dict[str, tuple[str, RigidTransform]] = {}
        """For each robot's prefix, the node that was moved to apply its map poses, and the node's pose."""

    def take_moved(self) -> list[tuple[str, int]]:
        """Return the nodes that have moved since the last call."""
        taken = list(self.moved)
        self.moved.clear()
        return taken

    def forget(self) -> None:
        """Delete the history of everything that moves."""
        self._graph.forget()
        self._waiting.clear()
        self.moved.clear()
        self.corrections.clear()

    def add_joint_state(self, topic: str, state: JointState) -> None:
        """Apply a message with joint positions."""
        time_ns = state.header.stamp.nanoseconds
        positions = state.position.tolist()
        if len(positions) not in (0, len(state.name)):
            text = f"{len(state.name)} names, but {len(positions)} positions"
            self._warnings.ignore(f"a joint state on {topic!r}", text)
            return
        prefix = prefix_of(topic)
        for given, position in zip(state.name, positions, strict=False):
            name = _named(prefix, given, self._nodes_of_joint)
            if name in self._nodes_of_joint or _named(prefix, given, self._followers) not in self._followers:
                self._set_joint(name, time_ns, position)

    def add_odometry(self, topic: str, odometry: Odometry) -> None:
        """Move a robot in its odometry frame."""
        prefix = prefix_of(topic)
        name = _named(prefix, odometry.child_frame_id, self._graph)
        parent = _named(prefix, odometry.header.frame_id, self._graph)
        try:
            hangs_on = self._graph.node(name).parent
            if hangs_on != parent:
                raise Disconnected(f"the parent of node {name!r} is {hangs_on!r}, not {parent!r}")
            self._move(name, odometry.header.stamp.nanoseconds, from_pose(odometry.pose.pose))
            if prefix in self.corrections:
                corrected, pose = self.corrections[prefix]
                self._move(corrected, odometry.header.stamp.nanoseconds, pose)
        except SceneGraphError as error:
            self._warnings.ignore(f"odometry on {topic!r}", error)
            return
        waiting = self._waiting.pop(prefix, None)
        if waiting is not None:
            self.add_map_pose(topic, waiting)

    def place(self, topic: str, message: TFMessage) -> None:
        """Move floating nodes in their parents.

        Between two messages the pose is interpolated, so place a node again as long as others ask for it.
        """
        for one in message.transforms:
            try:
                child, parent = self._graph.node(one.child_frame_id), without_slash(one.header.frame_id)
                if child.parent != parent:
                    raise Disconnected(
                        f"the parent of node {child.name!r} is {child.parent!r}, not {parent!r}"
                    )
                self._move(child.name, one.header.stamp.nanoseconds, from_transform(one.transform))
            except SceneGraphError as error:
                self._warnings.ignore(f"the place of {one.child_frame_id!r} on {topic!r}", error)

    def add_map_pose(self, topic: str, pose: PoseStamped) -> None:
        """Move the odometry frame so that the robot has its map pose.

        If a map pose arrives before the odometry of its time, it waits for that odometry.
        """
        prefix = prefix_of(topic)
        try:
            self._correct(prefix, pose)
        except (TooNew, NeverPlaced):
            self._waiting[prefix] = pose
        except SceneGraphError as error:
            self._warnings.ignore(f"a map pose on {topic!r}", error)

    def correct(self, prefix: str, name: str, since_ns: int, pose: RigidTransform) -> None:
        """Set a node's pose at each time of the robot's odometry, until the next map pose."""
        self._move(name, since_ns, pose)
        self.corrections[prefix] = (name, pose)

    def _correct(self, prefix: str, pose: PoseStamped) -> None:
        time_ns = pose.header.stamp.nanoseconds
        reference = _named(prefix, pose.header.frame_id, self._graph)
        base = _named(prefix, self._base, self._graph)
        corrected = self._child_on_the_way(reference, base)
        X_MB = from_pose(pose.pose)
        if corrected == base:
            self._move(base, time_ns, X_MB)
            return
        X_MC = X_MB @ self._graph.pose(base, corrected, time_ns)
        # Published poses of the past stay as they are: the correction applies from now on.
        known_ns, told_ns = self._graph.newest_ns(base), self._graph.newest_ns(corrected)
        now_ns = time_ns if known_ns is None or told_ns is None else min(known_ns, told_ns)
        self.correct(prefix, corrected, max(time_ns, now_ns), X_MC)

    def _child_on_the_way(self, ancestor: str, name: str) -> str:
        """Return the child of `ancestor` that is the node `name` or is above it."""
        above = self._graph.node(ancestor).name
        node = self._graph.node(name)
        while node.parent is not None:
            if node.parent == above:
                return node.name
            node = self._graph.node(node.parent)
        raise Disconnected(f"node {name!r} is not below {above!r}")

    def _move(self, name: str, time_ns: int, pose: RigidTransform) -> None:
        self._graph.move(name, time_ns, pose)
        self.moved[name, time_ns] = None

    def _set_joint(self, name: str, time_ns: int, position: float) -> None:
        try:
            joint = self._graph.joint(name)
            self._graph.set_joint(name, time_ns, position)
        except SceneGraphError as error:
            self._warnings.ignore(f"position of joint {name!r}", error)
            return
        if not joint.allows(position):
            self._warnings.say(f"joint {name!r}", f"is at {position:g}, beyond its limits {joint.limits}")
        for node in self._nodes_of_joint[name]:
            self.moved[node, time_ns] = None


def prefix_of(name: str) -> str:
    """Return the prefix of a topic or name: "red/" of "red/odom", "" of "odom"."""
    return name[: name.rfind("/") + 1]


def _named(prefix: str, name: str, known: Container[str]) -> str:
    """Return what a robot calls `name`, by its own prefix if that is known."""
    name = without_slash(name)
    return prefix + name if prefix and prefix + name in known else name
