"""Conversions between messages and shapes of the manipulation workers."""

from robbie_mp import Header
from robbie_mp.messages import Vector3
from robbie_mp.scene import RigidTransform
from robbie_mp.scene.conversion import from_pose, to_pose
from robbie_robots.modules.manipulation.messages import SeenShape, TableObjects
from robbie_robots.workers.manipulation.collisions import Shape
from robbie_robots.workers.manipulation.rotations import quaternion_of
from robbie_robots.workers.manipulation.table_view import TableView


def shape_message(shape: Shape) -> SeenShape:
    """Return the message of a shape."""
    place, turn = shape.pose[:3, 3].tolist(), quaternion_of(shape.pose[:3, :3]).tolist()
    x, y, z = shape.size_m
    return SeenShape(
        name=shape.name,
        pose=to_pose(RigidTransform.of(place, turn)),
        size=Vector3(x=x, y=y, z=z),
        is_round=shape.is_round,
    )


def shape_of(message: SeenShape) -> Shape:
    """Return the shape of a message."""
    size = (message.size.x, message.size.y, message.size.z)
    return Shape(message.name, size, from_pose(message.pose).matrix, message.is_round)


def view_message(view: TableView, header: Header) -> TableObjects:
    """Return the message of what is seen."""
    objects = [shape_message(shape) for shape in view.objects]
    return TableObjects(header=header, table=shape_message(view.table), objects=objects)


def view_of(message: TableObjects, stamp_s: float) -> TableView:
    """Return what a message shows, with the time of its image on the clock of the caller."""
    return TableView(stamp_s, shape_of(message.table), tuple(shape_of(one) for one in message.objects))
