"""The scene graph: the pose of every frame in every other frame, at any time in the last seconds.

How to describe and query it: docs/scene-graph.md.
"""

from robbie_mp.scene.described import SceneNotes as SceneNotes
from robbie_mp.scene.errors import BadJoint as BadJoint
from robbie_mp.scene.errors import Disconnected as Disconnected
from robbie_mp.scene.errors import DuplicateNode as DuplicateNode
from robbie_mp.scene.errors import MissingParent as MissingParent
from robbie_mp.scene.errors import NeverPlaced as NeverPlaced
from robbie_mp.scene.errors import NodeCycle as NodeCycle
from robbie_mp.scene.errors import NotAPose as NotAPose
from robbie_mp.scene.errors import NotMovable as NotMovable
from robbie_mp.scene.errors import SceneFileError as SceneFileError
from robbie_mp.scene.errors import SceneGraphError as SceneGraphError
from robbie_mp.scene.errors import TooNew as TooNew
from robbie_mp.scene.errors import TooOld as TooOld
from robbie_mp.scene.errors import UnknownNode as UnknownNode
from robbie_mp.scene.graph import SceneGraph as SceneGraph
from robbie_mp.scene.listener import SceneGraphListener as SceneGraphListener
from robbie_mp.scene.node import Joint as Joint
from robbie_mp.scene.node import JointType as JointType
from robbie_mp.scene.node import Mimic as Mimic
from robbie_mp.scene.node import Node as Node
from robbie_mp.scene.rigid_transform import RigidTransform as RigidTransform
from robbie_mp.scene.scene_file import read_scene as read_scene
