"""A message that exists can be encoded: what does not fit is refused where it is given."""

import copy
import inspect
import math
import pickle
from decimal import Decimal
from enum import Enum, IntEnum
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from strenum import StrEnum

from robbie_mp.messages import (
    CompressedImage,
    FieldError,
    FieldTypeError,
    FieldValueError,
    Header,
    Image,
    Imu,
    JointState,
    Joy,
    LaserScan,
    Message,
    OccupancyGrid,
    PointCloud2,
    Pose,
    Quaternion,
    TFMessage,
    Time,
    TransformStamped,
    Twist,
    Vector3,
    as_dict,
    from_dict,
    replace,
)


def test_what_is_left_out_has_its_default() -> None:
    scan = LaserScan()
    assert scan.header == Header(stamp=Time(sec=0, nanosec=0), frame_id="")
    assert (scan.angle_min, len(scan.ranges), scan.ranges.dtype) == (0.0, 0, np.dtype(np.float32))
    assert Pose().orientation.w == 1.0
    assert len(Imu().orientation_covariance) == 9


def test_help_shows_the_fields() -> None:
    assert str(inspect.signature(Quaternion)) == "(*, x=0.0, y=0.0, z=0.0, w=1.0)"
    assert str(inspect.signature(Message)) == "(**fields: 'Any') -> 'Self'"


def test_a_message_is_immutable() -> None:
    twist = Twist(linear=Vector3(x=0.2))
    with pytest.raises(AttributeError, match="Vector3 is immutable"):
        twist.linear.x = 1.0  # type: ignore[misc]
    with pytest.raises(AttributeError, match="Twist is immutable"):
        del twist.linear
    with pytest.raises(AttributeError, match="immutable"):
        twist.unknown = 1
    assert twist.linear.x == 0.2


def test_replace_makes_another_message() -> None:
    twist = Twist(linear=Vector3(x=0.2))
    assert replace(twist, angular=Vector3(z=1.0)) == Twist(linear=Vector3(x=0.2), angular=Vector3(z=1.0))
    assert twist.angular.z == 0.0


def test_a_message_holds_what_its_subscribers_will_see() -> None:
    scan = LaserScan(angle_min=0.1, range_max=np.float64(3), ranges=[1, 2.5])  # type: ignore[arg-type]
    assert scan.angle_min == float(np.float32(0.1)) != 0.1
    assert type(scan.angle_min) is float and type(scan.range_max) is float
    assert scan.ranges.dtype == np.float32
    assert LaserScan.decode(scan.encode()) == scan


def test_messages_are_equal_if_their_values_are() -> None:
    ranges = np.array([1.0, 2.0], np.float32)
    assert LaserScan(ranges=ranges) == LaserScan(ranges=ranges.copy())
    assert LaserScan(ranges=ranges) != LaserScan(ranges=ranges + 1)
    assert LaserScan(ranges=ranges) != LaserScan(ranges=ranges[:1])
    assert Vector3() != Quaternion()
    assert JointState(name=["a"]) != JointState(name=["b"])
    with pytest.raises(TypeError):
        hash(Vector3())


@pytest.mark.parametrize("length", [0, 3, 100_000])
def test_a_long_array_is_abbreviated_in_the_text(length: int) -> None:
    text = repr(LaserScan(ranges=np.ones(length, np.float32)))
    assert f"ranges=<{length} float32" in text
    assert len(text) < 500


WRONG_TYPES = [
    (Time, {"sec": 1.5}, "sec: expected int32, got 1.5 (float)"),
    (Time, {"sec": "1"}, "sec: expected int32, got '1' (str)"),
    (Time, {"sec": None}, "sec: expected int32, got None (NoneType)"),
    (Vector3, {"x": "1"}, "x: expected float64, got '1' (str)"),
    (PointCloud2, {"is_dense": 1}, "is_dense: expected a bool, got 1 (int)"),
    (Header, {"frame_id": b"map"}, "frame_id: expected a str, got b'map' (bytes)"),
    (LaserScan, {"header": Time()}, "header: expected a Header, got Time(sec=0, nanosec=0) (Time)"),
    (LaserScan, {"ranges": 360}, "an int as the number of elements works only in a loan"),
    (LaserScan, {"ranges": "far"}, "ranges: expected an array for float32[], got 'far' (str)"),
    (LaserScan, {"ranges": ["far"]}, "ranges: expected an array of float32, got one of <U3"),
    (LaserScan, {"ranges": [None]}, "ranges: expected an array of float32, got one of object"),
    (Joy, {"buttons": [0.5]}, "buttons: expected an array of int32, got one of float64"),
    (JointState, {"name": "left"}, "name: expected a list for string[], got 'left' (str)"),
    (JointState, {"name": ["left", 3]}, "name[1]: expected a str, got 3 (int)"),
    (TFMessage, {"transforms": [Time()]}, "transforms[0]: expected a TransformStamped"),
    (TFMessage, {"transforms": None}, "transforms: expected a list for geometry_msgs/TransformStamped[]"),
]
WRONG_VALUES = [
    (Time, {"sec": 2**31}, "sec: int32 is -2147483648 to 2147483647, got 2147483648"),
    (Time, {"nanosec": -1}, "nanosec: uint32 is 0 to 4294967295, got -1"),
    (Time, {"sec": 10**30}, "sec: int32 is"),
    (LaserScan, {"angle_min": 1e300}, "angle_min: 1e+300 is too large for float32"),
    (LaserScan, {"ranges": [1e300]}, "ranges: some numbers are too large for float32"),
    (
        LaserScan,
        {"ranges": np.zeros((2, 3), np.float32)},
        "ranges: expected an array of shape (N,), got (2, 3)",
    ),
    (LaserScan, {"ranges": [[1], [1, 2]]}, "ranges: expected an array for float32[]"),
    (Imu, {"orientation_covariance": np.eye(3)}, "expected an array of shape (9,), got (3, 3)"),
    (Imu, {"orientation_covariance": [0.0] * 8}, "expected an array of shape (9,), got (8,)"),
    (OccupancyGrid, {"data": [-1, 200]}, "data: int8 is -128 to 127, got -1 to 200"),
    (Header, {"frame_id": "a\0b"}, "frame_id: NUL ends a string"),
    (Header, {"frame_id": "\ud800"}, "is not UTF-8: surrogates not allowed"),
]


@pytest.mark.parametrize(("message_type", "fields", "said"), WRONG_TYPES)
def test_a_wrong_type_is_refused(message_type: type[Message], fields: dict[str, object], said: str) -> None:
    with pytest.raises(FieldTypeError) as caught:
        message_type(**fields)
    assert message_type.type_name in str(caught.value) and said in str(caught.value)
    assert isinstance(caught.value, TypeError)


@pytest.mark.parametrize(("message_type", "fields", "said"), WRONG_VALUES)
def test_a_wrong_value_is_refused(message_type: type[Message], fields: dict[str, object], said: str) -> None:
    with pytest.raises(FieldValueError) as caught:
        message_type(**fields)
    assert message_type.type_name in str(caught.value) and said in str(caught.value)
    assert isinstance(caught.value, ValueError)


class Mode(str, Enum):
    """Its text is `Mode.AUTO`."""

    AUTO = "auto"


class Colour(StrEnum):
    RED = "red"


class Plain(Enum):
    RED = "red"


class Word(str):
    def __str__(self) -> str:
        return "another text"


class Half(float, Enum):
    VALUE = 0.5


class Level(IntEnum):
    HIGH = 3


class Angry:
    """Something that cannot say its value."""

    def __index__(self) -> int:
        raise RuntimeError("no")

    __float__ = __index__


TAKEN = [
    (Header, "frame_id", Mode.AUTO, "auto"),
    (Header, "frame_id", Colour.RED, "red"),
    (Header, "frame_id", Word("word"), "word"),
    (Header, "frame_id", np.str_("name"), "name"),
    (JointState, "name", [Mode.AUTO, Word("word")], ["auto", "word"]),
    (JointState, "name", np.array(["a", "b"]), ["a", "b"]),
    (Time, "sec", Level.HIGH, 3),
    (Time, "sec", np.array(3), 3),
    (Time, "sec", np.uint64(3), 3),
    (Time, "sec", True, 1),
    (Vector3, "x", Half.VALUE, 0.5),
    (Vector3, "x", Level.HIGH, 3.0),
    (Vector3, "x", np.array(2.5), 2.5),
    (Vector3, "x", np.float16(2.5), 2.5),
    (Vector3, "x", Decimal("0.5"), 0.5),
    (Vector3, "x", Decimal("inf"), math.inf),
    (Vector3, "x", Fraction(1, 2), 0.5),
    (PointCloud2, "is_dense", np.True_, True),
]
REFUSED = [
    (Time, "sec", np.array([3])),
    (Time, "sec", np.array(3.5)),
    (Time, "sec", Decimal(3)),
    (Time, "sec", Angry()),
    (Time, "sec", np.ma.array(3, mask=True)),
    (Vector3, "x", np.array([3.5])),
    (Vector3, "x", np.complex64(3 + 1j)),
    (Vector3, "x", np.array(3 + 1j)),
    (Vector3, "x", np.str_("3")),
    (Vector3, "x", np.array("3")),
    (Vector3, "x", Decimal("1e400")),
    (Vector3, "x", np.longdouble("1e400")),
    (Vector3, "x", np.ma.masked),
    (Vector3, "x", np.timedelta64(3, "s")),
    (Vector3, "x", Angry()),
    (Header, "frame_id", Path("map")),
    (Header, "frame_id", b"map"),
    (Header, "frame_id", np.bytes_(b"map")),
    (Header, "frame_id", Plain.RED),
    (JointState, "name", np.array("left")),
    (JointState, "name", [b"left"]),
    (LaserScan, "ranges", np.ma.array([3.0, 4.0], mask=[False, True])),
    (LaserScan, "ranges", [Angry()]),
    (LaserScan, "ranges", [3 + 1j]),
    (PointCloud2, "is_dense", np.array([True])),
]


@pytest.mark.parametrize(("message_type", "field", "value", "held"), TAKEN)
def test_a_value_of_another_class_is_held_as_what_it_is(
    message_type: type[Message], field: str, value: object, held: object
) -> None:
    found = getattr(message_type(**{field: value}), field)
    assert found == held and type(found) is type(held)
    assert getattr(message_type.decode(message_type(**{field: value}).encode()), field) == held


@pytest.mark.parametrize(("message_type", "field", "value"), REFUSED)
def test_a_value_that_a_field_cannot_hold_is_refused_by_type_and_field(
    message_type: type[Message], field: str, value: object
) -> None:
    with pytest.raises(FieldError, match=rf"{message_type.type_name}\.{field}"):
        message_type(**{field: value})


def test_an_unknown_field_is_refused() -> None:
    with pytest.raises(TypeError, match="rangs"):
        LaserScan(rangs=[])  # type: ignore[call-arg]
    with pytest.raises(FieldTypeError, match="no field 'rangs'; did you mean 'ranges'"):
        from_dict(LaserScan, {"rangs": []})


@pytest.mark.parametrize(
    "given",
    [
        b"\x01\x02",
        bytearray(b"\x01\x02"),
        memoryview(b"\x01\x02"),
        [1, 2],
        (1, 2),
        range(1, 3),
        np.array([1, 2]),
    ],
    ids=lambda given: type(given).__name__,
)
def test_an_array_of_bytes_can_be_given_in_many_ways(given: object) -> None:
    image = CompressedImage(data=given)  # type: ignore[arg-type]
    assert (image.data.dtype, image.data.tolist()) == (np.dtype(np.uint8), [1, 2])


@pytest.mark.parametrize("empty", [b"", [], (), np.array([]), np.empty(0, np.int16)], ids=repr)
def test_an_empty_array_can_be_given_in_many_ways(empty: object) -> None:
    assert Image(data=empty) == Image()  # type: ignore[arg-type]


@pytest.mark.parametrize("step", [1, 2, -1])
def test_an_array_with_gaps_is_encoded_without(step: int) -> None:
    numbers = np.arange(10, dtype=np.float32)[::step]
    assert LaserScan.decode(LaserScan(ranges=numbers).encode()).ranges.tolist() == numbers.tolist()


def test_an_array_of_the_right_type_is_not_copied() -> None:
    ranges = np.ones(4, np.float32)
    assert LaserScan(ranges=ranges).ranges is ranges


def test_a_list_is_copied() -> None:
    names = ["left"]
    state = JointState(name=names)
    names.append("right")
    assert state.name == ["left"]


def test_floats_of_all_kinds_are_taken() -> None:
    vector = Vector3(x=math.inf, y=-0.0, z=2**60)
    assert (vector.x, math.copysign(1, vector.y), vector.z) == (math.inf, -1.0, float(2**60))
    assert math.isnan(Vector3(x=math.nan).x)


def test_a_message_can_be_copied_and_pickled() -> None:
    tree = TFMessage(transforms=[TransformStamped(child_frame_id="laser")])
    assert pickle.loads(pickle.dumps(tree)) == copy.deepcopy(tree) == tree


def test_a_message_is_a_dictionary_and_back() -> None:
    tree = TFMessage(transforms=[TransformStamped(header=Header(frame_id="map"), child_frame_id="laser")])
    plain = as_dict(tree)
    assert plain["transforms"][0]["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "map"}
    assert from_dict(TFMessage, plain) == tree
