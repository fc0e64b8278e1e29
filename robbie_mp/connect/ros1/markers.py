"""Places as markers, which RViz of ROS 1 draws: `visualization_msgs/MarkerArray`.

Two kinds of messages become markers. A message with a list `points`, as `PointsOfInterest`, has all places of
its topic. A message with a `header` and a `pose` is one place; with an `id`, each number is another place.
"""

import math
from typing import Any, NamedTuple

from robbie_mp.messages import Header, Message, PointOfInterest, Pose, from_dict
from robbie_mp.messages.field_types import Nested
from robbie_mp.messages.message import fields_of
from robbie_mp.messages.schema_parser import message_type_from_schema

MARKERS = "MarkerArray"
MAX_PLACES = 1000
"""Most markers of a topic."""
HEIGHT_M = 0.3
SPHERE, TEXT = 2, 9
DELETE_ALL = 3
MAX_TEXT = 80
_COLOURS = ((0.9, 0.8, 0.1), (1.0, 0.5, 0.0), (0.2, 0.8, 0.2), (0.5, 0.5, 0.5), (0.2, 0.5, 1.0))
"""By the number in the field `state`: yellow, orange, green, grey; for others blue."""
_OTHER_COLOUR = 4
_LINE = "=" * 80
_SCHEMA = f"""\
visualization_msgs/Marker[] markers
{_LINE}
MSG: visualization_msgs/Marker
uint8 ARROW=0
uint8 CUBE=1
uint8 SPHERE=2
uint8 CYLINDER=3
uint8 LINE_STRIP=4
uint8 LINE_LIST=5
uint8 CUBE_LIST=6
uint8 SPHERE_LIST=7
uint8 POINTS=8
uint8 TEXT_VIEW_FACING=9
uint8 MESH_RESOURCE=10
uint8 TRIANGLE_LIST=11
uint8 ADD=0
uint8 MODIFY=0
uint8 DELETE=2
uint8 DELETEALL=3
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string text
string mesh_resource
bool mesh_use_embedded_materials
{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{_LINE}
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
{_LINE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{_LINE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{_LINE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{_LINE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{_LINE}
MSG: std_msgs/ColorRGBA
float32 r
float32 g
float32 b
float32 a
"""
MARKER_ARRAY = message_type_from_schema("visualization_msgs/msg/MarkerArray", _SCHEMA)
"""The type as ROS 1 defines it; in ROS 2 it has more fields."""


def can_be_markers(message_type: type[Message]) -> bool:
    """Whether messages of a type have places that can be shown."""
    kinds = _kinds(message_type)
    return kinds.get("header") == Header.type_name and (
        kinds.get("pose") == Pose.type_name or kinds.get("points") == PointOfInterest.type_name
    )


def _kinds(message_type: type[Message]) -> dict[str, str]:
    """Return the types of the fields that are messages, or lists of messages."""
    kinds = {one.name: getattr(one.type, "element", one.type) for one in fields_of(message_type)}
    return {name: kind.layout.type_name for name, kind in kinds.items() if isinstance(kind, Nested)}


class ShownPlace(NamedTuple):
    """A place that is shown.

    Attributes:
        frame: frame of its position.
        x_m: position, m.
        y_m: as above.
        z_m: as above.
        text: what stands above it.
        colour: number of its colour in `_COLOURS`.
    """

    frame: str
    x_m: float
    y_m: float
    z_m: float
    text: str
    colour: int


class ShownPlaces:
    """The places of one topic, as markers.

    Args:
        message_type: a type for which `can_be_markers` holds.

    Attributes:
        left_out: places not shown because there are `MAX_PLACES` already, or a number is not finite.
    """

    def __init__(self, message_type: type[Message]):
        self._type = message_type
        self._places: dict[int, ShownPlace] = {}
        self.left_out = 0

    def state(self) -> list[list[Any]]:
        """Return all places, for a checkpoint."""
        return [[number, *place] for number, place in self._places.items()]

    def restore(self, state: list[list[Any]]) -> None:
        """Show the places of a checkpoint."""
        self._places = {number: ShownPlace(*place) for number, *place in state}

    def add(self, data: bytes) -> None:
        """Add what a new message says.

        Args:
            data: the message, encoded.

        Raises:
            DecodeError: the bytes are no message of the type.
        """
        message: Any = self._type.decode(data)
        if hasattr(message, "points"):
            self._places.clear()
            for number, point in enumerate(message.points):
                self._add(number, message.header, point.pose, point.name, _OTHER_COLOUR)
        else:
            number = getattr(message, "id", 0)
            number = number if isinstance(number, int) else 0
            self._add(number, message.header, message.pose, self._text(message), _colour(message))

    def markers(self) -> bytes:
        """Return all markers of the topic, encoded."""
        markers = [marker for place in self._places.values() for marker in _markers(place)]
        numbered = [{**marker, "id": number} for number, marker in enumerate(markers)]
        return from_dict(MARKER_ARRAY, {"markers": [{"action": DELETE_ALL}, *numbered]}).encode()

    def _add(self, number: int, header: Header, pose: Pose, text: str, colour: int) -> None:
        at = pose.position.x, pose.position.y, pose.position.z
        if not all(map(math.isfinite, at)) or (
            number not in self._places and len(self._places) >= MAX_PLACES
        ):
            self.left_out += 1
            return
        self._places[number] = ShownPlace(header.frame_id, *at, text[:MAX_TEXT], colour)

    def _text(self, message: Any) -> str:
        name = str(getattr(message, "name", ""))
        state = getattr(message, "state", None)
        words = [one.name.lower() for one in self._type._constants if one.value == state]
        return f"{name}: {words[0]}" if name and words else name


def _colour(message: Any) -> int:
    state = getattr(message, "state", None)
    return state if isinstance(state, int) and 0 <= state < _OTHER_COLOUR else _OTHER_COLOUR


def _markers(place: ShownPlace) -> list[dict[str, Any]]:
    """Return a ball where a place is, and its text above it."""
    at = place.x_m, place.y_m, place.z_m
    ball = _marker(place.frame, SPHERE, at, HEIGHT_M / 2, (HEIGHT_M,) * 3, _COLOURS[place.colour])
    above = _marker(place.frame, TEXT, at, 1.5 * HEIGHT_M, (0.0, 0.0, HEIGHT_M), (1.0, 1.0, 1.0))
    return [ball, {**above, "text": place.text}] if place.text else [ball]


def _marker(
    frame: str,
    kind: int,
    at: tuple[float, float, float],
    above_m: float,
    size: tuple[float, ...],
    colour: tuple[float, float, float],
) -> dict[str, Any]:
    """Return a marker. Its stamp is 0: RViz draws it wherever its frame is now."""
    return {
        "header": {"frame_id": frame},
        "type": kind,
        "pose": {
            "position": {"x": at[0], "y": at[1], "z": at[2] + above_m},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        },
        "scale": dict(zip("xyz", size, strict=True)),
        "color": dict(zip("rgba", (*colour, 1.0), strict=True)),
    }
