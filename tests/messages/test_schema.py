"""Types become ros2msg texts, and texts become types."""

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


def test_defaults_need_not_be_finite() -> None:
    text = "float32 used_s nan\nfloat64 way_m inf\nfloat64 least -inf\n"
    made = message_type_from_schema("my_msgs/msg/Mine", text)
    message = made()
    assert np.isnan(message.used_s)  # type: ignore[attr-defined]
    assert (message.way_m, message.least) == (np.inf, -np.inf)  # type: ignore[attr-defined]
    assert schema_text(made) == text


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
