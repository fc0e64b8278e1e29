"""Compares the codec written in C with the one in Python, over bytes that are changed again and again."""

import random
from collections.abc import Callable
from typing import Any

import numpy as np

from robbie_mp.messages import (
    Header,
    Image,
    JointState,
    Message,
    PointCloud2,
    PointField,
    TFMessage,
    TransformStamped,
    message_type_from_schema,
    stock_registry,
)
from robbie_mp.messages.codec.functions import FUNCTIONS
from robbie_mp.messages.message import fields_of

VARIABLE = message_type_from_schema(
    "test_msgs/msg/Variable",
    "string<=5 text\nstring[2] words\nstring<=3[<=2] few_words\nbool[] truths\nbool[3] three\n"
    "float64[<=3] few\ntest_msgs/Inner[] inner\n"
    "test_msgs/Inner[2] two\ntest_msgs/Nothing nothing\nint16 last\n"
    + "=" * 80
    + "\nMSG: test_msgs/Inner\nuint8 a\nfloat32[] b\n"
    + "=" * 80
    + "\nMSG: test_msgs/Nothing\n",
)
"""A type with all that can be limited, repeated or empty."""
TYPES = [*stock_registry(), VARIABLE]
MAX_SEEDS = 60
"""Most encodings of one type that are changed further."""


def python(message_type: type[Message], name: str) -> Callable[..., Any]:
    """The function in Python, which C must not differ from."""
    return FUNCTIONS[name](message_type._layout)


def outcome(function: Callable[..., Any], /, *values: Any, **fields: Any) -> Any:
    """Return the result of a call, or its error with the text."""
    try:
        return exact(function(*values, **fields))
    except Exception as error:
        return type(error), str(error).replace("Message.", "")


def exact(value: Any) -> Any:
    """A value with all its types, in a form in which NaN equals NaN."""
    if isinstance(value, Message):
        return type(value), [exact(getattr(value, field.name)) for field in fields_of(type(value))]
    if isinstance(value, np.ndarray):
        flags = value.flags.writeable, value.flags.aligned
        return value.dtype, value.shape, value.strides, value.tobytes(), flags
    if isinstance(value, list):
        return [exact(item) for item in value]
    return type(value), repr(value)


def encoded(message_type: type[Message], message: Message) -> bytes:
    """The encoding that Python makes."""
    buffer = bytearray(python(message_type, "encoded_size")(message))
    python(message_type, "encode_into")(message, memoryview(buffer))
    return bytes(buffer)


class Subject:
    """A message type, its functions in Python, and the encodings known so far."""

    def __init__(self, message_type: type[Message], seeds: list[bytes]):
        self.message_type = message_type
        self.decode = python(message_type, "decode")
        self.encode = python(message_type, "encode_into")
        self.size = python(message_type, "encoded_size")
        self.seeds = seeds

    def check(self, data: bytes) -> bool:
        """Decode bytes in both ways, and encode what comes of it; return whether they were a message."""
        buffer = np.frombuffer(b"\xaa" * 4 + data, np.uint8)[4:].data  # aligned as in shared memory
        mine, theirs = outcome(self.message_type.decode, buffer), outcome(self.decode, buffer)
        assert mine == theirs, (self.message_type.type_name, data.hex(), mine, theirs)
        if not isinstance(mine[1], list):
            return False
        message = self.message_type.decode(buffer)
        size = self.size(message)
        room = bytearray(size), bytearray(size)
        assert message.encoded_size() == size
        assert message.encode_into(memoryview(room[0])) == self.encode(message, memoryview(room[1])) == size
        assert room[0] == room[1], (self.message_type.type_name, data.hex())
        return True


def fuzz(seed: int, count: int) -> int:
    """Check `count` inputs made up from a seed; return how many of them were messages."""
    chance = random.Random(seed)
    header = Header(frame_id="läser")
    rich = [
        JointState(header=header, name=["a", "bc", ""], position=np.arange(3.0)),
        TFMessage(transforms=[TransformStamped(header=header, child_frame_id="x")] * 2),
        PointCloud2(fields=[PointField(name="x", count=1)] * 2, data=np.arange(9, dtype=np.uint8)),
        Image(encoding="mono8", data=np.arange(5, dtype=np.uint8)),
        VARIABLE(text="abc", truths=np.ones(3, np.bool_), few=np.ones(2), words=["a", "ä"], few_words=["b"]),
    ]
    subjects = [
        Subject(each, [each().encode(), *(one.encode() for one in rich if type(one) is each)])
        for each in TYPES
    ]
    found = 0
    for _ in range(count):
        subject = chance.choice(subjects)
        data = _changed(chance, chance.choice(subject.seeds))
        if subject.check(data):
            found += 1
            if len(subject.seeds) < MAX_SEEDS:
                subject.seeds.append(data)
            else:
                subject.seeds[chance.randrange(MAX_SEEDS)] = data
    return found


def _changed(chance: random.Random, seed: bytes) -> bytes:
    data = bytearray(seed)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        at = chance.randrange(len(data) + 1)
        word = at // 4 * 4
        match chance.randrange(6):
            case 0:
                data[at : at + 1] = bytes([chance.choice((0, 1, 2, 65, 0x7F, 0x80, 0xC3, 0xFF))])
            case 1:
                data[at : at + 1] = chance.randbytes(1)
            case 2:
                number = chance.choice((0, 1, 2, 3, 4, 5, 8, 100, len(data), 2**31, 2**32 - 1))
                data[word : word + 4] = number.to_bytes(4, "little")
            case 3:
                data[word:word] = chance.choice((bytes(4), b"\1\0\0\0", b"abc\0", chance.randbytes(4)))
            case 4:
                del data[word : word + 4]
            case 5:
                del data[max(at, 4) :]
    return bytes(data)
