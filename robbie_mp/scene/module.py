"""The scene graph service: updates the scene graph and publishes it."""

from pathlib import Path
from typing import Any

from robbie_mp.messages import JointState, Odometry, PoseStamped, TFMessage, TimeJump
from robbie_mp.module.module import Module, setting
from robbie_mp.module.settings import REQUIRED, SettingError
from robbie_mp.scene import JointType, RigidTransform, SceneFileError, SceneGraph, SceneNotes, read_scene
from robbie_mp.scene.announcing import fixed_transforms, state_of, transforms_at
from robbie_mp.scene.updating import SceneUpdater, prefix_of
from robbie_mp.scene.warn_once import WarnOnce

MOVED_LIMIT = 2000
"""Maximum number of transforms in one message."""


class SceneGraphService(Module):
    """Applies joint states, odometry and map poses to the scene graph, and publishes the changes.

    It subscribes to JointState on any topic, Odometry on `odom` and PoseStamped on `map_pose`. For robots
    whose nodes have a prefix, as in "red/base_link", the topics are `red/odom` and `red/map_pose`. A map pose
    moves the child of its frame that carries the robot, the odometry frame, by the correction that makes the
    map pose true. A TFMessage on `placed` moves any floating nodes, such as the map of another robot.

    It publishes moving transforms as TFMessage on `tf`, and fixed ones once on `tf_static`. It also publishes
    SceneGraphState, which holds the whole graph. Both `tf_static` and SceneGraphState are latched.

    After a restart, it restores the last corrections. It gets the rest with the next messages.
    """

    file: Path = setting(REQUIRED, "the scene graph (YAML or URDF)", must_exist=True)
    base: str = setting("base_link", "the node whose pose a map pose gives, without its robot's prefix")
    history_s: float = setting(10.0, "how long past values are remembered", minimum=0.1)
    period_s: float = setting(0.02, "minimum time between two messages on `tf`", minimum=0.001)
    state_period_s: float = setting(0.1, "minimum time between two SceneGraphStates", minimum=0.001)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the file, so that mistakes in it are reported before anything starts."""
        file = settings["file"]
        assert isinstance(file, Path)
        try:
            read_scene(file)
        except SceneFileError as error:
            raise SettingError(str(error), "file") from error

    def setup(self) -> None:
        """Read the graph, and subscribe to the messages that move it."""
        notes = SceneNotes()
        self.graph = SceneGraph(read_scene(self.file, notes), history_s=self.history_s)
        self._log_notes(notes)
        self.warnings = WarnOnce(self.log)
        self.updater = SceneUpdater(self.graph, self.base, self.warnings)
        self.next_s = {"tf": 0.0, "state": 0.0}
        self.fixed_announced = False
        self.state_changed = True
        self.updates = 0
        for prefix, (name, since_ns, *pose) in (self.restored or {}).items():
            if name in self.graph and self.graph.node(name).joint_type is JointType.FLOATING:
                self.updater.correct(prefix, name, since_ns, RigidTransform(*pose))
        self.subscribe(JointState, self.on_joint_state, optional=True)
        self.subscribe(TFMessage, self.on_placed, topic="placed", optional=True)
        self.subscribe(TimeJump, self.on_time_jump, optional=True)
        floating = [node.name for node in self.graph if node.joint_type is JointType.FLOATING]
        for prefix in sorted(set(map(prefix_of, floating))):
            self.subscribe(Odometry, self.on_odometry, topic=f"{prefix}odom")
            self.subscribe(PoseStamped, self.on_map_pose, topic=f"{prefix}map_pose", optional=True)

    def _log_notes(self, notes: SceneNotes) -> None:
        """Log what was left out of the file."""
        for text in notes.warnings:
            self.log.warning("%s", text)
        for line in notes.balance.lines("elements")[1:]:
            self.log.debug("%s: %s", self.file.name, line)

    def on_joint_state(self, state: JointState) -> None:
        """Move joints."""
        self.updater.add_joint_state(self.envelope.topic, state)
        self._tell_moved()

    def on_placed(self, message: TFMessage) -> None:
        """Move floating nodes."""
        self.updater.place(self.envelope.topic, message)
        self._tell_moved()

    def on_odometry(self, odometry: Odometry) -> None:
        """Move a robot."""
        self.updater.add_odometry(self.envelope.topic, odometry)
        self._tell_moved()

    def on_map_pose(self, pose: PoseStamped) -> None:
        """Move a robot's odometry frame."""
        before = dict(self.updater.corrections)
        self.updater.add_map_pose(self.envelope.topic, pose)
        if self.updater.corrections != before:
            self._remember()
        self._tell_moved()

    def on_time_jump(self, _jump: TimeJump) -> None:
        """Forget all positions."""
        self.updater.forget()
        self._remember()
        self.state_changed = True

    def tick(self) -> None:
        """Publish changes that had to wait, and once the fixed transforms."""
        self._tell_moved()
        now_s = self.monotonic_s()
        if not self.fixed_announced:
            fixed = fixed_transforms(self.graph, self.clock.now_ns())
            self.fixed_announced = self.publish(fixed, topic="tf_static", latched=True)
        if self.state_changed and now_s >= self.next_s["state"]:
            self.next_s["state"] = now_s + self.state_period_s
            self.state_changed = not self.publish(state_of(self.graph), latched=True)
        ignored = f", {self.warnings.ignored} ignored" if self.warnings.ignored else ""
        self.status = f"{len(self.graph)} nodes, {self.updates} updates{ignored}"

    def _tell_moved(self) -> None:
        """Publish the moved nodes, or leave that to the next tick if the last message was just sent."""
        now_s = self.monotonic_s()
        waiting = len(self.updater.moved)
        if not waiting or (now_s < self.next_s["tf"] and waiting < MOVED_LIMIT):
            return
        self.next_s["tf"] = now_s + self.period_s
        moved = self.updater.take_moved()
        self.updates += len(moved)
        self.publish(transforms_at(self.graph, moved), topic="tf")
        self.state_changed = True

    def _remember(self) -> None:
        state: dict[str, Any] = {
            prefix: [name, self.graph.newest_ns(name), *pose]
            for prefix, (name, pose) in self.updater.corrections.items()
        }
        self.checkpoint(state)
