"""The scene graph: the pose of every frame in every other frame, at any time in the last seconds.

How to describe and query it: docs/scene-graph.md.
"""

from robbie_mp.scene.described import SceneNotes
from robbie_mp.scene.errors import (
    BadJoint,
    Disconnected,
    DuplicateNode,
    MissingParent,
    NeverPlaced,
    NodeCycle,
    NotAPose,
    NotMovable,
    SceneFileError,
    SceneGraphError,
    TooNew,
    TooOld,
    UnknownNode,
)
from robbie_mp.scene.graph import SceneGraph
from robbie_mp.scene.listener import SceneGraphListener
from robbie_mp.scene.node import Joint, JointType, Mimic, Node
from robbie_mp.scene.rigid_transform import RigidTransform
from robbie_mp.scene.scene_file import read_scene

__all__ = [
    "BadJoint",
    "Disconnected",
    "DuplicateNode",
    "Joint",
    "JointType",
    "Mimic",
    "MissingParent",
    "NeverPlaced",
    "Node",
    "NodeCycle",
    "NotAPose",
    "NotMovable",
    "RigidTransform",
    "SceneFileError",
    "SceneGraph",
    "SceneGraphError",
    "SceneGraphListener",
    "SceneNotes",
    "TooNew",
    "TooOld",
    "UnknownNode",
    "read_scene",
]
