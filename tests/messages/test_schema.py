"""Types become ros2msg texts, and texts become types."""

from typing import Any

import numpy as np
import pytest

from robbie_mp.messages import (
    BatteryState,
    Message,
    Odometry,
    SchemaError,
    message_type_from_schema,
    nested_types,
    schema_text,
    stock_registry,
)

STOCK = list(stock_registry())


@pytest.mark.parametrize("message_type", STOCK, ids=lambda each: each.type_name)
def test_a_type_made_from_its_schema_is_the_same(message_type: type[Message]) -> None:
    text = schema_text(message_type)
    made = message_type_from_schema(message_type.type_name, text)
    assert schema_text(made) == text
    assert made().encode() == message_type().encode()
    assert repr(made()) == repr(message_type()).replace(message_type.__name__, made.__name__, 1)


def test_each_nested_type_is_defined_once() -> None:
    text = schema_text(Odometry)
    for nested in nested_types(Odometry):
        package, _, name = nested.type_name.split("/")
        assert text.count(f"{'=' * 80}\nMSG: {package}/{name}\n") == 1
    assert len(nested_types(Odometry)) == text.count("MSG:") == 9


def test_constants_stay() -> None:
    made = message_type_from_schema(BatteryState.type_name, schema_text(BatteryState))
    assert made.POWER_SUPPLY_STATUS_FULL == BatteryState.POWER_SUPPLY_STATUS_FULL == 4  # type: ignore[attr-defined]


def test_defaults_need_not_be_finite_and_stand_in_a_comment() -> None:
    text = "float32 used_s  # default: nan\nfloat64 way_m  # default: inf\nfloat64 least  # default: -inf\n"
    assert schema_text(message_type_from_schema("my_msgs/msg/Mine", text.replace(" # default:", ""))) == text
    made = message_type_from_schema("my_msgs/msg/Mine", text)
    message = made()
    assert np.isnan(message.used_s)  # type: ignore[attr-defined]
    assert (message.way_m, message.least) == (np.inf, -np.inf)  # type: ignore[attr-defined]
    assert schema_text(made) == text


def test_declared_defaults_and_the_order_of_lines_stay() -> None:
    text = 'int32 first\nuint8 A=1\nfloat64 x 0.0\nstring name ""\n'
    assert schema_text(message_type_from_schema("my_msgs/msg/Mine", text)) == text


FREE_FORM = """
# A comment at the top, with 'quotes" that do not match
int32 LIMIT = 0x10   # sixteen
float32 HALF=.5
string GREETING='it is # no comment'   # this is
string BARE=plain text
bool YES=true
uint8[] data         # bytes
\tHeader header
builtin_interfaces/Time stamp
other_msgs/msg/Thing thing
Local[2] local
string<=5[<=3] words ["a", 'b']
float64[3] vector [1, 2.5, 3]
bool on True
int8 version -3
uint8 class

================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
===
MSG: other_msgs/Thing
bool yes
=====
MSG: my_msgs/Local
int16 x 7
"""


def test_a_schema_written_by_hand_is_understood() -> None:
    made = message_type_from_schema("my_msgs/msg/Mine", FREE_FORM, version=4)
    message = made()
    assert made.version == 4
    constants = (made.LIMIT, made.HALF, made.GREETING, made.BARE, made.YES)  # type: ignore[attr-defined]
    assert constants == (16, 0.5, "it is # no comment", "plain text", True)
    assert message.words == ["a", "b"]  # type: ignore[attr-defined]
    assert message.vector.tolist() == [1.0, 2.5, 3.0]  # type: ignore[attr-defined]
    assert [each.x for each in message.local] == [7, 7]  # type: ignore[attr-defined]
    assert (message.on, message.version_, message.class_) == (True, -3, 0)  # type: ignore[attr-defined]
    full = made(data=b"ab", words=["abcde"], class_=3)
    assert made.decode(full.encode()) == full
    assert np.array_equal(made.decode(full.encode()).data, [97, 98])  # type: ignore[attr-defined]
    again = message_type_from_schema("my_msgs/msg/Mine", schema_text(made), version=4)
    assert schema_text(again) == schema_text(made)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("float32", "in the line 'float32' of its schema: expected 'type name'"),
        ("float99 x", "no definition of my_msgs/float99"),
        ("std_msgs/Headr h\n===\nMSG: std_msgs/Header\nstring s", "did you mean 'std_msgs/Header'"),
        ("wstring w", "wstring is not supported"),
        ("uint8 x 300", "uint8 is 0 to 255, got 300"),
        ("uint8 x nonsense(", "in the line 'uint8 x nonsense("),
        ("uint8 x\nuint8 x", "there are two fields x"),
        ("uint8 x\nuint8 x=1", "a constant cannot be called x"),
        ("uint8 decode=5", "a constant cannot be called decode"),
        ("uint8 x²", "'x²' is not a name"),
        ("bool x {[]: 1}", "in the line 'bool x {[]: 1}'"),
        ("uint8[ x", "'uint8[' is not a type"),
        ("uint8<=4 x", "'uint8<=4' is not a type"),
        ("uint8[0] x", "uint8[0]: the length of an array is an int >= 1"),
        ("Mine x\n===\nMSG: my_msgs/Mine\nMine x", "my_msgs/Mine contains itself"),
        ("uint8 x\n===\nuint8 y", "no 'MSG: package/Type' line"),
    ],
)
def test_what_is_not_understood_is_said(text: str, said: str) -> None:
    with pytest.raises(SchemaError) as caught:
        message_type_from_schema("my_msgs/msg/Mine", text)
    assert said in str(caught.value) and "my_msgs/" in str(caught.value)


KINDS = r"""
# As in the interface tests of ROS 2: constants, defaults, bounds and arrays of every kind.
bool TRUE=true
byte BYTE=255
char CHAR=100
float32 FLOAT=1.125
int64 LOWEST=-9223372036854775808
uint64 HIGHEST=18446744073709551615
int32 HEX=0x1f
string GREETING="Hello world! # no comment"
string BARE=Hello world!
bool flag true
byte octet 50
char letter 100
float32 ratio -1.125
float64 small 1.5e-3
int8 low -128
uint64 high 18446744073709551615
string first "Hello'world!"
string second 'Hello"world!'
string third 'Hello\'world!'
string fourth "Hello\"world!"
string fifth "tab\tback\\slash"
string bare default of words
string<=22 bounded "Hello world!"
bool[3] flags [false, true, false]
byte[3] octets [0, 1, 255]
char[3] letters [0, 1, 127]
int64[3] wide [0, 9223372036854775807, -9223372036854775808]
uint64[3] widest [0, 1, 18446744073709551615]
uint64[] widest_sequence [1, 18446744073709551615]
uint64[<=3] widest_bounded [18446744073709551615]
float32[3] ratios [1.125, 0.0, -1.125]
float64[] whole [1, 2, 3]
string[3] words ["", "max value", 'min "value"']
string[<=3] few_words ["a", "b"]
string<=5[<=2] short_words ["abc"]
string[] any_words
Inner inner
Inner[2] two
Inner[<=2] few
Inner[] many
================================================================================
MSG: test_msgs/Inner
uint64[] numbers [18446744073709551615, 0]
"""


def test_constants_and_defaults_of_every_kind_are_kept() -> None:
    made = message_type_from_schema("test_msgs/msg/Kinds", KINDS)
    for kind in (made, message_type_from_schema("test_msgs/msg/Kinds", schema_text(made))):
        held: Any = kind()
        assert (kind.TRUE, kind.BYTE, kind.CHAR, kind.FLOAT, kind.HEX) == (True, 255, 100, 1.125, 31)  # type: ignore[attr-defined]
        assert (kind.LOWEST, kind.HIGHEST) == (-(2**63), 2**64 - 1)  # type: ignore[attr-defined]
        assert (kind.GREETING, kind.BARE) == ("Hello world! # no comment", "Hello world!")  # type: ignore[attr-defined]
        assert (held.flag, held.octet, held.letter, held.ratio, held.small) == (True, 50, 100, -1.125, 0.0015)
        assert (held.low, held.high) == (-128, 2**64 - 1)
        assert [held.first, held.second, held.third, held.fourth] == [
            "Hello'world!", 'Hello"world!', "Hello'world!", 'Hello"world!']  # fmt: skip
        assert (held.fifth, held.bare, held.bounded) == (
            "tab\tback\\slash", "default of words", "Hello world!")  # fmt: skip
        assert held.widest.dtype == np.uint64 and held.widest.tolist() == [0, 1, 2**64 - 1]
        assert held.wide.tolist() == [0, 2**63 - 1, -(2**63)] and held.octets.tolist() == [0, 1, 255]
        assert held.widest_sequence.tolist() == [1, 2**64 - 1] and held.widest_bounded.tolist() == [2**64 - 1]
        assert held.whole.dtype == np.float64 and held.flags.tolist() == [False, True, False]
        assert held.words == ["", "max value", 'min "value"'] and held.short_words == ["abc"]
        assert held.few_words == ["a", "b"] and held.any_words == []
        assert [one.numbers.tolist() for one in (held.inner, *held.two)] == [[2**64 - 1, 0]] * 3
        assert kind.decode(held.encode()) == held


@pytest.mark.parametrize(
    ("kind", "value"),
    [("uint64", -1), ("int64", 2**63), ("uint64", 2**64), ("int8", 2**64 - 1), ("float64", 10**400)],
)
def test_default_of_an_array_that_does_not_fit_is_refused(kind: str, value: int) -> None:
    with pytest.raises(SchemaError, match=f"{kind}"):
        message_type_from_schema("test_msgs/msg/A", f"{kind}[] a [1, {value}]")
