"""A scene graph for any module, built from the transforms that the robot publishes."""

from robbie_mp.messages import TFMessage, TimeJump, TransformStamped
from robbie_mp.messages.frames import without_slash
from robbie_mp.module.module import Module
from robbie_mp.scene.conversion import from_transform
from robbie_mp.scene.errors import SceneGraphError
from robbie_mp.scene.graph import HISTORY_S, SceneGraph
from robbie_mp.scene.node import Joint, JointType, Node
from robbie_mp.scene.rigid_transform import IDENTITY, RigidTransform
from robbie_mp.scene.warn_once import WarnOnce

FLOATING = Joint(JointType.FLOATING)


class SceneGraphListener:
    """Subscribes to the robot's transforms and answers queries for poses.

        def setup(self) -> None:
            self.scene = SceneGraphListener(self)
            self.subscribe(LaserScan, self.on_scan)

        def on_scan(self, scan: LaserScan) -> None:
            X_ML = self.scene.pose("map", "laser", scan.header.stamp.nanoseconds)

    It subscribes to TFMessage on the topics `tf` and `tf_static`; the publisher may be the SceneGraphService,
    a playback or a ROS robot. `tf_static` is latched, so it knows the fixed transforms from its start.

    Args:
        module: the module that it is part of; create the listener in `setup()`.
        history_s: how much of the past it remembers, in s.
        hears_time_jumps: subscribe to TimeJump, and delete the history at each jump. Use False if your module
            subscribes to TimeJump; then call `forget()` at each jump.
    """

    def __init__(self, module: Module, *, history_s: float = HISTORY_S, hears_time_jumps: bool = True):
        self.graph = SceneGraph(history_s=history_s)
        self._module = module
        self._warnings = WarnOnce(module.log)
        module.subscribe(TFMessage, self._on_transforms)
        if hears_time_jumps:
            module.subscribe(TimeJump, lambda _jump: self.forget(), optional=True)

    def pose(self, a: str, b: str, time_ns: int | None = None) -> RigidTransform:
        """Return X_AB, the pose of node `b` in the frame of node `a`.

        Args:
            a: the node in whose frame the pose is expressed.
            b: the node whose pose is returned.
            time_ns: the time; None for the newest time at which every joint between them is known.

        Raises:
            UnknownNode, Disconnected: the transforms received so far do not place one of the nodes.
            TooOld, TooNew: for this time, a joint between them is no longer, or not yet, known.
        """
        return self.graph.pose(a, b, time_ns)

    def forget(self) -> None:
        """Delete the history of everything that moves."""
        self.graph.forget()

    def _on_transforms(self, message: TFMessage) -> None:
        topic = self._module.envelope.topic
        if topic not in ("tf", "tf_static"):
            return
        for transform in message.transforms:
            try:
                self._learn(transform, is_fixed=topic == "tf_static")
            except SceneGraphError as error:
                child, parent = transform.child_frame_id, transform.header.frame_id
                self._warnings.ignore(f"the pose of {child!r} in {parent!r}", error)

    def _learn(self, transform: TransformStamped, is_fixed: bool) -> None:
        parent, name = without_slash(transform.header.frame_id), without_slash(transform.child_frame_id)
        pose = from_transform(transform.transform)
        node = Node(name, parent, pose if is_fixed else IDENTITY, None if is_fixed else FLOATING)
        if parent not in self.graph:
            self.graph.add(Node(parent))
        if name not in self.graph:
            self.graph.add(node)
        elif (before := self.graph.node(name)) != node:
            if before.parent not in (None, parent):
                self._warnings.say(
                    f"parent of {name}", f"{name!r} hung on {before.parent!r}, now on {parent!r}"
                )
            self.graph.hang(node)
        if not is_fixed:
            self.graph.move(name, transform.header.stamp.nanoseconds, pose)
