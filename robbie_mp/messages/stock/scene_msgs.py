"""The scene graph as messages: where everything is, in one message."""

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.stock.builtin_interfaces import Time
from robbie_mp.messages.stock.geometry_msgs import Transform
from robbie_mp.messages.stock.std_msgs import Header


class SceneNodeState(Message, name="robbie_msgs/msg/SceneNodeState", version=1):
    """One node of a scene graph, and where it is in its parent."""

    name: str = DEFAULT
    parent: str = DEFAULT  # '' of a root
    type: str = DEFAULT  # how it moves: fixed, revolute, continuous, prismatic or floating
    joint: str = DEFAULT  # name of the joint it moves by; '' if it is fixed or floating
    is_placed: bool = DEFAULT  # False: it moves, but nothing has been heard of where it is
    stamp: Time = DEFAULT  # when it was there; 0 if it is fixed
    transform: Transform = DEFAULT  # its pose in the parent


class SceneGraphState(Message, name="robbie_msgs/msg/SceneGraphState", version=1):
    """All nodes of the scene graph, each after its parent, and the newest that is known of each."""

    header: Header = DEFAULT  # stamp: the newest of its nodes
    nodes: list[SceneNodeState] = DEFAULT
