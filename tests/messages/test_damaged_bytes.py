"""Any bytes give a message, or a DecodeError that says where; no crash, no huge allocation."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.messages import DecodeError, Message, message_type_from_schema, stock_registry
from tests.messages._support.strategies import PATIENT, messages

STOCK = list(stock_registry())
VARIABLE = message_type_from_schema(
    "test_msgs/msg/Variable",
    "string<=5 text\nstring[2] words\nbool[] truths\nfloat64[<=3] few\ntest_msgs/Inner[] inner\nint16 last\n"
    + "=" * 80
    + "\nMSG: test_msgs/Inner\nuint8 a\nfloat32[] b\n",
)
ANY_TYPE = st.sampled_from([*STOCK, VARIABLE])


def decode_or_explain(message_type: type[Message], data: bytes) -> None:
    try:
        message = message_type.decode(data)
    except DecodeError as error:
        assert isinstance(error, ValueError)
        assert message_type.type_name in str(error) and "at byte" in str(error)
    else:
        assert message_type.decode(message.encode()).encode() == message.encode()


@given(ANY_TYPE, st.binary(max_size=300))
@settings(PATIENT, max_examples=200)
def test_garbage(message_type: type[Message], garbage: bytes) -> None:
    decode_or_explain(message_type, garbage)
    decode_or_explain(message_type, b"\x00\x01\x00\x00" + garbage)


@given(st.data())
@settings(PATIENT, max_examples=60)
def test_a_message_with_some_bytes_changed(data: st.DataObject) -> None:
    message_type = data.draw(ANY_TYPE)
    encoded = bytearray(data.draw(messages(message_type)).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        encoded[data.draw(st.integers(0, len(encoded) - 1))] = data.draw(st.integers(0, 255))
    decode_or_explain(message_type, bytes(encoded))


@given(st.data())
@settings(PATIENT, max_examples=40)
def test_a_message_cut_off_anywhere(data: st.DataObject) -> None:
    message_type = data.draw(ANY_TYPE)
    encoded = data.draw(messages(message_type)).encode()
    for length in range(len(encoded)):
        with pytest.raises(DecodeError):
            message_type.decode(encoded[:length])


@pytest.mark.parametrize(
    ("schema", "said"),
    [
        ("float64[] a", "a at byte 4: 4294967295 elements of at least 8 bytes, but 8 bytes are left"),
        ("string[] a", "a at byte 4: 4294967295 elements of at least 4 bytes, but 8 bytes are left"),
        (
            "test_msgs/Inner[] a",
            "a at byte 4: 4294967295 elements of at least 12 bytes, but 8 bytes are left",
        ),
        ("string a", "a at byte 8: needs 4294967295 bytes, 8 are left"),
        ("uint8[<=3] a", "a at byte 4: 4294967295 elements are more than 3"),
    ],
)
def test_a_huge_length_allocates_nothing(schema: str, said: str) -> None:
    inner = "=" * 80 + "\nMSG: test_msgs/Inner\nstring a\nfloat64 b\n"
    message_type = message_type_from_schema("test_msgs/msg/Main", f"{schema}\n{inner}")
    data = b"\x00\x01\x00\x00\xff\xff\xff\xff" + bytes(8)
    with pytest.raises(DecodeError):
        message_type.decode(data)  # makes the decoder
    tracemalloc.start()
    try:
        with pytest.raises(DecodeError) as caught:
            message_type.decode(data)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (
            b"\x00\x00\x00\x00" + bytes(4),
            "encapsulation at byte 0: it is 00 00 00 00, XCDR1 little endian is 00 01",
        ),
        (b"\x00\x07\x00\x00" + bytes(4), "it is 00 07 00 00"),
        (b"\x00\x01\x00\x00\x03\x00\x00\x00abc", "a at byte 10: a string ends with a NUL, this one does not"),
        (b"\x00\x01\x00\x00\x04\x00\x00\x00a\xff\xfe\x00", "a at byte 9: not UTF-8: invalid start byte"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(data: bytes, said: str) -> None:
    message_type = message_type_from_schema("test_msgs/msg/Text", "string a")
    with pytest.raises(DecodeError) as caught:
        message_type.decode(data)
    assert said in str(caught.value)


def test_truth_values_that_are_neither_are_true() -> None:
    message_type = message_type_from_schema("test_msgs/msg/Truth", "bool one\nbool[3] three\nbool[] some")
    message = message_type.decode(b"\x00\x01\x00\x00" + bytes([7, 0, 1, 9, 2, 0, 0, 0, 0xFF, 0]))
    assert message == message_type(
        one=True, three=np.array([False, True, True]), some=np.array([True, False])
    )


def test_something_else_than_bytes_is_a_type_error() -> None:
    for message_type in STOCK[:3]:
        with pytest.raises(TypeError):
            message_type.decode("text")  # type: ignore[arg-type]
