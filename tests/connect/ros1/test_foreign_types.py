"""Types made from definitions of ROS 1: rosbags and genpy agree, and hostile definitions are refused."""

import hashlib
import json
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from robbie_mp.connect.ros1.conversion import ConversionError
from robbie_mp.connect.ros1.foreign_types import (
    MAX_VALUES,
    DefinitionError,
    ForeignType,
    _Parser,
    _texts,
    foreign_type,
)
from robbie_mp.messages import message_type_from_schema
from robbie_mp.messages.schema import layout
from tests.connect.ros1._support.ros import needs_ros1, system_python
from tests.messages._support.rosbags_bridge import store_with
from tests.messages._support.strategies import PATIENT, messages

NOETIC = get_typestore(Stores.ROS1_NOETIC)
NOETIC_NAMES = [name for name in NOETIC.fielddefs if not name.startswith("builtin_interfaces")]
RICH = (
    "actionlib_msgs",
    "diagnostic_msgs",
    "shape_msgs",
    "trajectory_msgs",
    "visualization_msgs",
    "stereo_msgs",
)
RICH_NAMES = [name for name in NOETIC_NAMES if name.startswith(RICH)]
SECTION = "=" * 80 + "\nMSG: "
HEADER = f"{SECTION}std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
GAS = f"""# What the nose smells; an = in a comment is no constant.
Header header   # of the nose
string UNIT=ppm # not a comment in ROS 1
uint8 CH4 = 0x1f
float32 LIMIT=1e3
bool WARNS=True
time[2] seen
byte level
char[] raw
Reading[] readings
{HEADER}{SECTION}nose_msgs/Reading
string name
duration age

float64[3] values
"""
DEFINITIONS_OF_GENPY = """
import importlib, json
found = {}
for package in ("actionlib_msgs", "geometry_msgs", "move_base_msgs", "nav_msgs", "sensor_msgs", "std_msgs"):
    for one in vars(importlib.import_module(package + ".msg")).values():
        if hasattr(one, "_full_text"):
            found[one._type] = one._md5sum, one._full_text
print(json.dumps(found))
"""


def of_noetic(type_name: str) -> tuple[str, str, str]:
    """Name, MD5 sum and definition of a type, as a connection in ROS 1 has them."""
    definition, md5 = NOETIC.generate_msgdef(type_name, ros_version=1)
    return type_name.replace("/msg/", "/"), md5, definition


def defined(definition: str, name: str = "nose_msgs/Gas") -> ForeignType:
    """The type of a definition, with the MD5 sum that fits."""
    try:
        md5 = _Parser(_texts(name, definition)).parse(name).md5
    except DefinitionError:
        md5 = ""
    return foreign_type(name, md5, definition)


def check_empty(made: ForeignType) -> None:
    """Compare the robot's encoding of an empty message with what comes from ROS; read its description."""
    encoded = made.message_type().encode()
    assert made.from_ros1(made.kind.to_ros1(encoded, 7)) == encoded
    again = message_type_from_schema(*made.description[::2])
    assert layout(again) == layout(made.message_type)


def test_every_definition_of_noetic_is_understood() -> None:
    assert len(NOETIC_NAMES) > 150
    for name in NOETIC_NAMES:
        _, md5, definition = of_noetic(name)
        parser = _Parser(_texts(name.replace("/msg/", "/"), definition))
        assert parser.parse(name.replace("/msg/", "/")).md5 == md5, name


@pytest.mark.parametrize(
    "name", ["diagnostic_msgs/msg/DiagnosticArray", "visualization_msgs/msg/MarkerArray"]
)
@given(data=st.data())
@settings(PATIENT, max_examples=5)
def test_any_message_that_rosbags_has_serialised_is_converted(name: str, data: st.DataObject) -> None:
    made = foreign_type(*of_noetic(name))
    message = data.draw(messages(made.message_type))
    assert made.from_ros1(ros1_bytes(made, message.encode())) == message.encode()


def ros1_bytes(made: ForeignType, encoded: bytes) -> bytes:
    """What rosbags makes of an encoded message."""
    store = store_with(made.description.name, made.description.schema)
    return bytes(store.cdr_to_ros1(encoded, made.description.name))


@pytest.mark.slow
@pytest.mark.parametrize("name", RICH_NAMES)
def test_an_empty_message_of_each_type_is_converted(name: str) -> None:
    check_empty(foreign_type(*of_noetic(name)))


@pytest.mark.slow
@needs_ros1
def test_definitions_with_comments_have_the_sums_of_genpy() -> None:
    found = json.loads(system_python(DEFINITIONS_OF_GENPY))
    assert len(found) > 80
    for name, (md5, definition) in found.items():
        if name != "std_msgs/Header":
            assert foreign_type(name, md5, definition).kind.md5 == md5


def test_a_definition_as_its_author_has_written_it_is_understood() -> None:
    made = defined(GAS)
    check_empty(made)
    own: Any = made.message_type
    assert (own.UNIT, own.CH4, own.LIMIT, own.WARNS) == ("ppm # not a comment in ROS 1", 31, 1000.0, True)
    inner = hashlib.md5(b"string name\nduration age\nfloat64[3] values").hexdigest()
    text = (
        "string UNIT=ppm # not a comment in ROS 1\nuint8 CH4=0x1f\nfloat32 LIMIT=1e3\nbool WARNS=True\n"
        f"2176decaecbce78abc3b96ef049fabed header\ntime[2] seen\nbyte level\nchar[] raw\n{inner} readings"
    )
    assert made.kind.md5 == hashlib.md5(text.encode()).hexdigest()
    assert made.kind.to_ros1(own().encode(), 5)[:4] == b"\5\0\0\0"


@pytest.mark.parametrize(
    ("definition", "reason"),
    [
        ("Reading one", "no text of nose_msgs/Reading"),
        ("Gas one", "contains itself"),
        ("A a\n" + "".join(f"{SECTION}nose_msgs/{a}\n{b} x\n" for a, b in ("AB", "BA")), "contains itself"),
        ("\n".join(f"uint8 a{i}" for i in range(2001)), "more than 2000 fields"),
        ("uint8 " + "a" * 5000, "more than 4096 characters"),
        ("#" * (300 << 10), "more than 262144 characters"),
        ("uint8 x" + f"\n{SECTION}a/B\n\n" * 300, "more than 256 types"),
        (f"{SECTION}\n", "no line 'MSG: package/Type'"),
        (f"E[] x\n{SECTION}nose_msgs/E\n\n", "list of nothing"),
        ("uint8[0] x", "list of nothing"),
        ("uint8[999999999] x", "the limit is"),
        ("string[999999999] x", "the limit is"),
        (f"Header h\n{SECTION}std_msgs/Header\nuint32 seq\n", "is not ROS's"),
        (f"builtin_interfaces/Time t\n{SECTION}builtin_interfaces/Time\nuint8 x\n", "a type of ROS 2"),
        ("uint8 X=300", "nose_msgs/msg/Gas"),
        ("uint8 X=?", "not a constant"),
        ("time X=3", "has no constants"),
        ("uint8 x y", "not a field"),
        ("uint8 x\nuint8 x", "two fields x"),
        ("wstring x", "no text of nose_msgs/wstring"),
        ("float32 two__underscores", "cannot have this name"),
    ],
)
def test_what_cannot_be_a_type_is_refused_with_the_reason(definition: str, reason: str) -> None:
    with pytest.raises(DefinitionError, match=reason):
        defined(definition)


def test_types_nested_too_deep_are_refused() -> None:
    chain = "".join(f"{SECTION}nose_msgs/N{i}\nN{i + 1}[] x\n" for i in range(200))
    with pytest.raises(DefinitionError, match="nested more than"):
        defined(f"N0 x\n{chain}")


def test_a_definition_that_doubles_with_each_type_is_refused_at_once() -> None:
    chain = "".join(f"{SECTION}nose_msgs/N{i}\nN{i + 1} x\nN{i + 1} y\n" for i in range(15))
    with pytest.raises(DefinitionError, match="more than 2000 fields"):
        defined(f"N0 x\n{chain}{SECTION}nose_msgs/N15\nuint8 x\n")


def test_a_definition_must_have_the_sum_that_comes_with_it() -> None:
    with pytest.raises(DefinitionError, match="its publisher says 'abc'"):
        foreign_type("nose_msgs/Gas", "abc", "uint8 x")
    with pytest.raises(DefinitionError, match="sends no definition"):
        foreign_type("nose_msgs/Gas", "abc", "")
    with pytest.raises(DefinitionError, match="not the name of a type"):
        foreign_type("Gas", "abc", "uint8 x")


def test_messages_that_would_become_too_many_objects_are_refused() -> None:
    made = defined(f"R[] x\n{SECTION}nose_msgs/R\nuint8 a\n")
    assert made.max_bytes == MAX_VALUES
    with pytest.raises(ConversionError, match="the limit"):
        made.from_ros1(bytes(MAX_VALUES + 1))
    assert defined("uint8[] x").max_bytes == float("inf")


LINES = st.sampled_from(
    [
        "uint8 a",
        "string[] words",
        "Header h",
        "Gas g",
        "R[] r",
        "R[3] s",
        "time t",
        "byte B=-1",
        "string S='",
        'string T="\\',
        "bool[] b # =",
        "float32 F=nan",
        "char type_name",
        "int8 self",
        "uint64[2] import",
        HEADER.strip(),
        f"{SECTION}nose_msgs/R",
        "====",
        "MSG: a/b",
    ]
)


@given(st.text() | st.lists(LINES | st.text(max_size=9), max_size=12).map("\n".join), st.binary(max_size=64))
@example('float32 F=nan\nstring T="\\\nchar type_name\nint8 self\nuint64[2] import', bytes(29))
@settings(PATIENT, max_examples=100)
def test_no_definition_does_more_than_be_refused(definition: str, data: bytes) -> None:
    try:
        made = defined(definition)
    except DefinitionError:
        return
    check_empty(made)
    try:
        encoded = made.from_ros1(data)
    except ConversionError:
        return
    made.message_type.decode(encoded)
