"""The encoding, byte for byte, where other readers are silent; and where it is written."""

import numpy as np
import pytest

from robbie_mp.messages import (
    BufferTooSmall,
    DecodeError,
    FieldError,
    Header,
    JointState,
    LaserScan,
    Message,
    MessageError,
    PointField,
    Time,
    float64,
    message_type_from_schema,
    uint8,
)


class Empty(Message, name="test_msgs/msg/Empty"):
    pass


class Fleet(Message, name="test_msgs/msg/Fleet"):
    robots: list[JointState]


class Awkward(Message, name="test_msgs/msg/Awkward"):
    """Fields named as what the codec uses."""

    type: uint8
    len: str
    range: list[str]
    bytes: float64


def test_a_header_is_encoded_as_cdr_says() -> None:
    header = Header(stamp=Time(sec=1, nanosec=2), frame_id="map")
    assert header.encode() == (
        b"\x00\x01\x00\x00"  # XCDR1, little endian
        b"\x01\x00\x00\x00\x02\x00\x00\x00"
        b"\x04\x00\x00\x00map\x00"
    )


def test_a_message_without_fields_is_one_byte() -> None:
    assert Empty().encode() == b"\x00\x01\x00\x00\x00"
    assert Empty.decode(Empty().encode()) == Empty()
    with pytest.raises(DecodeError, match="test_msgs/msg/Empty"):
        Empty.decode(b"\x00\x01\x00\x00")


def test_fields_may_be_named_like_what_the_codec_uses() -> None:
    message = Awkward(type=3, len="abc", range=["d", "ef"], bytes=1.5)
    assert Awkward.decode(message.encode()) == message


def test_what_follows_a_list_is_aligned_also_if_the_list_is_empty() -> None:
    schema = "string[3] words\nuint8[] bytes\ntest_msgs/Odd[] odd\nfloat64 last\n" + "=" * 80
    kind = message_type_from_schema(
        "test_msgs/msg/Main", f"{schema}\nMSG: test_msgs/Odd\nfloat64[] a\nuint8 b\n"
    )
    for length in range(9):
        message = kind(words=["", "", "a" * length], last=1.0)
        assert kind.decode(message.encode()) == message
        assert message.encode()[-8:] == np.float64(1.0).tobytes()


def test_padding_is_zero_whatever_was_in_the_buffer() -> None:
    message = JointState(header=Header(frame_id="a"), name=["b", "cde"], position=[1.0])  # type: ignore[arg-type]
    buffer = bytearray(b"\xff" * message.encoded_size())
    message.encode_into(memoryview(buffer))
    assert bytes(buffer) == message.encode()


@pytest.mark.parametrize("offset", [0, 1, 4, 7, 64])
def test_a_message_is_written_where_it_should_be_and_nowhere_else(offset: int) -> None:
    message = JointState(header=Header(frame_id="a"), name=["b"], velocity=[1.0, 2.0])  # type: ignore[arg-type]
    size = message.encoded_size()
    buffer = bytearray(b"\xaa" * (offset + size + 9))
    assert message.encode_into(memoryview(buffer), offset) == size
    assert buffer[offset : offset + size] == message.encode()
    assert set(buffer[:offset] + buffer[offset + size :]) <= {0xAA}


@pytest.mark.parametrize("message", [Time(sec=1), LaserScan(ranges=[1.0, 2.0]), JointState(name=["a", "b"])])  # type: ignore[arg-type]
def test_a_buffer_that_is_too_small_is_refused(message: Message) -> None:
    size = message.encoded_size()
    for short in range(size):
        with pytest.raises(BufferTooSmall, match=f"needs {size} bytes, the buffer has {short}"):
            message.encode_into(memoryview(bytearray(short)))


def test_a_read_only_buffer_is_refused() -> None:
    with pytest.raises(MessageError, match="LaserScan cannot be encoded into this buffer"):
        LaserScan().encode_into(memoryview(bytes(1000)))


def test_a_list_changed_after_the_fact_is_refused_when_encoded() -> None:
    state = JointState(name=["left"])
    state.name.append(3)  # type: ignore[arg-type]
    for encode in (state.encode, state.encoded_size):
        with pytest.raises(FieldError, match=r"sensor_msgs/msg/JointState\.name\[1\]: expected a str, got 3"):
            encode()


def test_a_list_changed_deep_inside_is_refused_when_encoded() -> None:
    message = Fleet(robots=[JointState(name=["left"])])
    message.robots[0].name.append(3)  # type: ignore[arg-type]
    with pytest.raises(FieldError, match=r"sensor_msgs/msg/JointState\.name\[1\]: expected a str, got 3"):
        message.encode()


def test_up_to_three_bytes_may_follow_a_message() -> None:
    field = PointField(name="x", count=1)
    for padding in range(4):
        assert PointField.decode(field.encode() + bytes(padding)) == field
    with pytest.raises(DecodeError, match="PointField at byte 24: 4 bytes are left behind the last field"):
        PointField.decode(field.encode() + bytes(4))


def test_an_empty_string_may_come_without_its_nul() -> None:
    assert Header.decode(b"\x00\x01\x00\x00" + bytes(12)) == Header()
