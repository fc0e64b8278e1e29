"""The codec written in C does what Python does: the same bytes, messages and errors."""

import array
import gc
import sys
import tracemalloc
from collections.abc import Callable
from contextlib import suppress
from decimal import Decimal
from enum import Enum, IntEnum
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.bus._hot.choice import native, why_not
from robbie_mp.messages import (
    DriveCommand,
    Header,
    Image,
    JointState,
    LaserScan,
    Message,
    PointCloud2,
    TFMessage,
    Time,
    TransformStamped,
    Vector3,
    lay_out,
    message_type_from_schema,
    uint8,
)
from robbie_mp.messages.field_types import Numbers
from robbie_mp.messages.loans import Layout, PythonLayout, lay_out_in_python
from robbie_mp.messages.message import fields_of
from tests.messages._support.codec_fuzz import TYPES, VARIABLE, encoded, exact, fuzz, outcome, python
from tests.messages._support.strategies import PATIENT, definitions, messages

pytestmark = pytest.mark.skipif(native() is None, reason=f"the module written in C: {why_not()}")

ANY_TYPE = st.sampled_from(TYPES) | definitions().map(
    lambda text: message_type_from_schema("random_msgs/msg/Main", text)
)


class Level(IntEnum):
    HIGH = 3


class Mode(str, Enum):
    """Its text is `Mode.AUTO`."""

    AUTO = "auto"


class Half(float, Enum):
    VALUE = 0.5


class Renamed(str):
    def __str__(self) -> str:
        return "another text"


class Angry:
    """Something that cannot say its value."""

    def __index__(self) -> int:
        raise RuntimeError("no")

    __float__ = __index__


class Percent:
    """Something with a value, such as a quantity of a library."""

    def __init__(self, value: Any):
        self.value = value

    def __float__(self) -> Any:
        return self.value / 100

    def __index__(self) -> Any:
        return self.value


ODD: list[Any] = [
    None, True, False, 0, 1, -1, 127, 128, 255, 256, 2**15, 2**31, 2**32, 2**63 - 1, 2**63, 2**64 - 1,
    2**64, -(2**63), 10**400, 0.5, 1e300, -0.0, float("nan"), float("inf"), 1j, np.float64(1.5),
    np.float32(0.1), np.int8(-3), np.uint64(2**64 - 1), np.bool_(True), "", "abc", "äöü", "a\0b", "\ud800",
    "far too long", b"", b"abc", bytearray(b"x"), [], [1, 2, 3], ["a", "b"], ["a", 3], ["\ud800", "b"],
    ("a", "b"), [None], [0.5] * 9, range(3), {}, np.zeros(3, np.float32), np.zeros(9), np.zeros(36),
    np.zeros(0, np.uint8), np.zeros(0), np.ones(4, np.bool_), np.ones((2, 2)), np.ones(18)[::2], np.ones(6,
    np.float32)[::2], np.ones(3, ">f4"), np.arange(5, dtype=np.uint8), np.float64(2), np.array(7.0),
    np.zeros(3, "U1"), Time(sec=3), Header(frame_id="a"), [Time()], [Vector3()], np.zeros(3, np.int8),
    np.array([1.5, 1e300, 3.0]), np.ones(1)[::2], Time, object(), ..., Mode.AUTO, Half.VALUE, Level.HIGH,
    Renamed("x"), [Mode.AUTO, Renamed("x")], Angry(), [Angry()], Percent(7), Decimal(3), Decimal("0.5"),
    Decimal("1e400"), Decimal("inf"), Fraction(1, 2), Path("a"), memoryview(b"a"), np.str_("n"),
    np.bytes_(b"x"), np.array([3]), np.array(3), np.array([[3]]), np.array([3.5]), np.array(True),
    np.array("x"), np.array("3"), np.array(["x", "y"]), np.array([1, None]), np.complex64(3),
    np.complex128(3 + 1j), np.array(3 + 1j), np.longdouble(3), np.longdouble("1e400"), np.float16(2),
    np.datetime64(3, "s"),
    np.timedelta64(3, "s"), np.ma.masked, np.ma.array(3, mask=True), np.ma.array([3, 4], mask=[False, True]),
    np.ma.array([3, 4]), np.array([3], ">i4"), [2**64 - 1, 1], [2**64], [2**63, -1], {"a"}, {1: 2},
]  # fmt: skip
"""Values that a field may be given: some fit some fields."""


@pytest.mark.slow
@given(st.data())
@settings(PATIENT, max_examples=200)
def test_messages_are_created_alike(data: st.DataObject) -> None:
    message_type = data.draw(ANY_TYPE)
    fields = {
        field.name: getattr(message, field.name)
        for message in [data.draw(messages(message_type))]
        for field in fields_of(message_type)
        if data.draw(st.booleans())
    }
    made = message_type(**fields)
    assert exact(made) == exact(python(message_type, "__new__")(message_type, **fields))
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            assert getattr(made, name) is value


@pytest.mark.parametrize("message_type", TYPES, ids=lambda each: each.type_name)
def test_odd_values_are_taken_or_refused_alike(message_type: type[Message]) -> None:
    create = python(message_type, "__new__")
    for field in fields_of(message_type):
        for value in ODD:
            fields = {field.name: value}
            assert outcome(message_type, **fields) == outcome(create, message_type, **fields)


def test_wrong_calls_are_refused_alike() -> None:
    create = python(Vector3, "__new__")
    create.__qualname__ = "Vector3.__new__"
    kind: Any = Vector3
    for arguments, fields in (
        ((1.0,), {}),
        ((), {"w": 1.0}),
        ((), {"x": 1.0, "X": 2}),
        ((1.0, 2.0), {"x": 1.0}),
    ):
        said = outcome(kind, *arguments, **fields)
        assert said == outcome(create, kind, *arguments, **fields)
        assert isinstance(said[0], type) and issubclass(said[0], TypeError)


def test_field_names_need_not_be_interned() -> None:
    names = ["".join(["linear_", "m_per_s"]), "".join(["angular_", "rad_per_s"])]
    made = DriveCommand(**{names[1]: 2.0, names[0]: 1.0})  # type: ignore[arg-type]
    assert (made.linear_m_per_s, made.angular_rad_per_s) == (1.0, 2.0)


@pytest.mark.slow
@given(st.data())
@settings(PATIENT, max_examples=200)
def test_messages_are_encoded_alike(data: st.DataObject) -> None:
    message_type = data.draw(ANY_TYPE)
    message = data.draw(messages(message_type))
    expected = encoded(message_type, message)
    assert message.encoded_size() == len(expected)
    offset = data.draw(st.integers(0, 9))
    buffer = bytearray(b"\xaa" * (offset + len(expected) + 5))
    assert message.encode_into(memoryview(buffer), offset) == len(expected)
    assert bytes(buffer) == b"\xaa" * offset + expected + b"\xaa" * 5
    for room in data.draw(st.lists(st.integers(0, len(expected) - 1), max_size=5)):
        short = memoryview(bytearray(room))
        said = outcome(message.encode_into, short)
        assert said == outcome(python(message_type, "encode_into"), message, short)


@pytest.mark.slow
@given(st.data())
@settings(PATIENT, max_examples=300)
def test_bytes_are_decoded_alike_however_damaged(data: st.DataObject) -> None:
    message_type = data.draw(ANY_TYPE)
    whole = bytearray(data.draw(messages(message_type)).encode())
    decode = python(message_type, "decode")
    for changes in range(5):
        assert_decoded_alike(message_type, decode, bytes(whole))
        at = data.draw(st.integers(0, len(whole) - 1))
        what = data.draw(st.sampled_from(["byte", "word", "cut", "longer"]) if changes else st.just("byte"))
        if what == "byte":
            whole[at] = data.draw(st.sampled_from([0, 1, 2, 0x7F, 0x80, 0xFF]) | st.integers(0, 255))
        elif what == "word":
            word = data.draw(st.integers(0, 12) | st.just(2**32 - 1)).to_bytes(4, "little")
            whole[at // 4 * 4 : at // 4 * 4 + 4] = word
        elif what == "cut":
            del whole[max(at, 1) :]
        else:
            whole += bytes(data.draw(st.integers(1, 5)))


@given(ANY_TYPE, st.binary(max_size=200), st.booleans())
@settings(PATIENT, max_examples=200)
def test_garbage_is_decoded_alike(message_type: type[Message], garbage: bytes, begins_well: bool) -> None:
    head = b"\0\1\0\0" if begins_well else b""
    assert_decoded_alike(message_type, python(message_type, "decode"), head + garbage)


def test_bytes_changed_again_and_again_are_decoded_and_encoded_alike() -> None:
    assert fuzz(seed=1, count=3000) > 500


def assert_decoded_alike(
    message_type: type[Message], decode: Callable[[Any], Message], data: bytes | bytearray
) -> None:
    aligned = np.empty(len(data) + 8, np.uint8)
    for offset in (0, 4, 1):
        buffer = aligned[offset : offset + len(data)]
        buffer[:] = np.frombuffer(data, np.uint8)
        for view in (buffer.data, buffer.data.toreadonly()):
            assert outcome(message_type.decode, view) == outcome(decode, view)


@pytest.mark.parametrize(
    "message_type", [Vector3, Header, LaserScan, PointCloud2], ids=lambda each: each.__name__
)
def test_any_buffer_is_read_alike(message_type: type[Message]) -> None:
    encoding = message_type().encode()
    encoding += bytes(-len(encoding) % 4)
    words = array.array("I", encoding)
    released = memoryview(encoding)
    released.release()
    sources: list[Any] = [
        encoding, bytearray(encoding), memoryview(encoding), words, memoryview(words),
        np.frombuffer(encoding, np.uint8), np.frombuffer(encoding, np.uint32),
        np.repeat(np.frombuffer(encoding, np.uint8), 2)[::2], memoryview(encoding)[::2], memoryview(encoding
        + encoding)[::2], np.frombuffer(encoding, np.uint8).reshape(2, -1), memoryview(encoding).cast("b"),
        memoryview(encoding).cast("c"), released, "text", None, 5, [1, 2], encoding[:3], b"", np.zeros(0),
    ]  # fmt: skip
    decode = python(message_type, "decode")
    for source in sources:
        assert outcome(message_type.decode, source) == outcome(decode, source)


@pytest.mark.parametrize(
    "message", [Vector3(x=1.0), Header(frame_id="a"), LaserScan(ranges=np.ones(3, np.float32))]
)
def test_any_buffer_is_written_alike(message: Message) -> None:
    size = message.encoded_size()

    def targets() -> list[tuple[Any, ...]]:
        released = memoryview(bytearray(size))
        released.release()
        return [
            (bytearray(size),), (memoryview(bytearray(size)),), (bytearray(size + 3), 3), (bytearray(size +
            3), 4), (bytearray(size), -size), (bytearray(size), -3), (bytearray(size), size + 7),
            (bytearray(size), 10**30), (bytearray(size + 1), True), (bytearray(size + 1), np.int64(1)),
            (bytearray(size), 1.5), (bytearray(size), None), (bytes(size),), (memoryview(bytes(size)),),
            (np.zeros(size, np.uint8),), (np.zeros(size, np.int8).data,), (np.zeros(size,
            np.uint32),), (memoryview(bytearray(2 * size))[::2],), (np.zeros((2, size), np.uint8),),
            (memoryview(bytearray(4 * size)).cast("I"),), (array.array("B", bytes(size)),),
            (array.array("b", bytes(size)),), (released,), ("text",), (None,), (), (bytearray(size), 0, 0),
        ]  # fmt: skip

    encode = python(type(message), "encode_into")
    encode.__qualname__ = f"{type(message).__name__}.encode_into"
    for mine, theirs in zip(targets(), targets(), strict=True):
        said = outcome(message.encode_into, *mine)
        assert said == outcome(encode, message, *theirs)
        if said[0] is int:
            assert bytes(mine[0]) == bytes(theirs[0])


CHANGES: list[tuple[Message, str, Any]] = [
    (JointState(name=["a"]), "name", ["a", 3]),
    (JointState(name=["a"]), "name", ("a", "b")),
    (JointState(name=["a"]), "name", ["a", "\ud800"]),
    (JointState(), "position", np.ones(4)[::2]),
    (JointState(), "position", np.ones(4, np.float32)),
    (JointState(), "position", None),
    (Vector3(), "x", 3),
    (Vector3(), "x", "3"),
    (Time(), "sec", 2**31),
    (Time(), "sec", True),
    (Time(), "nanosec", -1),
    (Header(), "stamp", Vector3()),
    (Header(), "frame_id", "a\0b"),
    (Header(), "frame_id", "äöü"),
    (Header(), "frame_id", b"a"),
    (PointCloud2(), "is_dense", 1),
    (PointCloud2(), "is_dense", None),
    (TFMessage(), "transforms", [Time()]),
    (LaserScan(), "angle_min", 1e300),
    (LaserScan(), "angle_min", 1),
    (VARIABLE(), "two", []),
    (VARIABLE(), "words", ["a"]),
]  # fmt: skip


@pytest.mark.parametrize(("message", "name", "value"), CHANGES)
def test_a_message_changed_by_force_is_encoded_alike(message: Message, name: str, value: object) -> None:
    message_type = type(message)
    object.__setattr__(message, name, value)
    size = outcome(message.encoded_size)
    assert size == outcome(python(message_type, "encoded_size"), message)
    buffers = bytearray(500), bytearray(500)
    said = outcome(message.encode_into, buffers[0])
    assert said == outcome(python(message_type, "encode_into"), message, buffers[1])
    if said[0] is int:
        assert buffers[0] == buffers[1]


COUNTS: list[Any] = [0, 1, 3, -1, True, 2**40, 10**30, np.int64(3), 2.5, None, "3"]
"""What may be given as the number of elements of an array that is lent."""


def written(layout: Layout[Message], room: int, *offset: Any) -> Any:
    """What a layout says, and what it writes into a buffer."""
    buffer = np.full(room, 0xAA, np.uint8)
    message = layout.write(buffer.data, *offset)
    for name in layout.loaned:
        array = getattr(message, name)
        array[:] = 1
        assert array.flags.writeable and (not len(array) or np.shares_memory(array, buffer))
    return exact([layout.size, sorted(layout.loaned), message, buffer])


@pytest.mark.parametrize("message_type", TYPES, ids=lambda each: each.type_name)
def test_messages_are_laid_out_alike(message_type: type[Message]) -> None:
    arrays = [
        (field.name, field.type) for field in fields_of(message_type) if isinstance(field.type, Numbers)
    ]
    lent: dict[str, Any] = {name: 2 for name, kind in arrays if kind.length is None}
    assert not isinstance(lay_out(message_type, lent), PythonLayout), "it should be C's"
    cases: list[dict[str, Any]] = [{}, {"no_field": 1}, {name: 2 for name, _ in arrays}, lent]
    cases += [{field.name: count} for field in fields_of(message_type) for count in COUNTS]
    for fields in cases:
        mine = outcome(lambda fields: lay_out(message_type, fields).size, fields)
        assert mine == outcome(lambda fields: lay_out_in_python(message_type, fields).size, fields)
        if mine[0] is int and (size := int(mine[1])) < 10_000:
            layouts = lay_out(message_type, fields), lay_out_in_python(message_type, fields)
            for call in ((size,), (size + 9, 4), (size - 1,), (0,), (size, 1), (size, -size), (size, None)):
                assert outcome(written, layouts[0], *call) == outcome(written, layouts[1], *call)


def test_a_layout_can_be_written_again() -> None:
    names = ["a"]
    layout = lay_out(JointState, {"name": names, "position": 2})
    names.append("b")
    buffers = bytearray(layout.size), bytearray(layout.size)
    first, second = (layout.write(memoryview(each)) for each in buffers)
    first.position[:], second.position[:] = 1.0, 2.0
    assert (first.position[0], second.position[0], first.name) == (1.0, 2.0, ["a"])
    assert first.name is not second.name
    assert first.name is not layout.write(memoryview(buffers[0])).name


def test_a_message_without_a_value_is_refused_alike() -> None:
    message = Vector3()
    object.__delattr__(message, "y")
    for name in ("encoded_size", "encode_into"):
        arguments = (bytearray(100),) if name == "encode_into" else ()
        said = outcome(getattr(message, name), *arguments)
        assert said == outcome(python(Vector3, name), message, *arguments)


def test_a_class_may_have_functions_of_its_own() -> None:
    class Counted(Message, name="test_msgs/msg/Counted"):
        made: ClassVar[int] = 0
        number: uint8 = 0

        def __init__(self, **fields: object) -> None:
            type(self).made += 1

        def encoded_size(self) -> int:
            return super().encoded_size() + 3

    class Doubled(Message, name="test_msgs/msg/Doubled"):
        number: uint8 = 0

    assert Counted(number=3).number == 3
    assert (Counted().encoded_size(), Counted.made) == (8, 2)
    assert Doubled(number=2).number == 2
    Doubled.__init__ = lambda self, **fields: object.__setattr__(self, "number", 9)  # type: ignore[method-assign]
    assert Doubled(number=2).number == 9


def test_views_cannot_be_made_writable_if_the_buffer_is_not() -> None:
    image = Image.decode(memoryview(Image(data=b"abc").encode()))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="WRITEABLE"):
        image.data.flags.writeable = True


def test_a_class_that_nobody_uses_is_collected() -> None:
    kind: Any = message_type_from_schema(
        "test_msgs/msg/Gone", "float32[] a\nbuiltin_interfaces/Time[] b\nfloat64 c 1.5"
    )
    kind.decode(kind(a=[1], b=[]).encode())
    with pytest.raises(TypeError):
        kind(a="x")
    del kind
    gc.collect()
    assert not [each for each in Message.__subclasses__() if each.__name__ == "Gone"]


@pytest.mark.slow
def test_nothing_leaks() -> None:
    scan = LaserScan(header=Header(frame_id="laser"), ranges=np.ones(9, np.float32))
    tree = TFMessage(transforms=[TransformStamped(child_frame_id="ä")] * 2)
    sent: list[tuple[Any, bytes]] = [
        (type(each), each.encode()) for each in (scan, tree, VARIABLE(), DriveCommand(linear_m_per_s=1.0))
    ]
    names, values = ["a"], np.ones(1)

    def work() -> None:
        for message_type, encoding in sent:
            message = message_type.decode(encoding)
            message.encode_into(bytearray(len(encoding)))
            for wrong in (encoding[:-1], encoding + bytes(9), b"\0\1\0\0" + b"\xff" * len(encoding)):
                with suppress(ValueError):
                    message_type.decode(wrong)
            with suppress(ValueError):
                message.encode_into(bytearray(len(encoding) - 1))
        JointState(name=names, position=values)
        JointState(name=names, position=values, effort=(1.0,))  # type: ignore[arg-type]

    counted = [Header, Time, VARIABLE, scan.ranges, names, values, sent[0][1], np.dtype(np.float32)]
    rounds = 200
    for _ in range(rounds):
        work()
    gc.collect()
    before = [sys.getrefcount(each) for each in counted]
    tracemalloc.start()
    try:
        work()
        gc.collect()
        start = tracemalloc.get_traced_memory()[0]
        for _ in range(rounds):
            work()
        gc.collect()
        assert tracemalloc.get_traced_memory()[0] - start < 16 * rounds, "16 bytes: the smallest object"
    finally:
        tracemalloc.stop()
    assert [sys.getrefcount(each) for each in counted] == before
