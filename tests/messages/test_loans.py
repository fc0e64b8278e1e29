"""A loaned message is written in place: what its constructor and encoder would have made of it."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.messages import (
    BufferTooSmall,
    FieldTypeError,
    FieldValueError,
    Header,
    Image,
    Imu,
    JointState,
    LaserScan,
    Message,
    PointCloud2,
    PointField,
    lay_out,
    stock_registry,
)
from robbie_mp.messages.field_types import Numbers
from robbie_mp.messages.message import fields_of
from tests.messages._support.strategies import PATIENT, messages


def sequences(message_type: type[Message]) -> set[str]:
    return {
        field.name
        for field in fields_of(message_type)
        if isinstance(field.type, Numbers) and field.type.length is None
    }


LENDING = [each for each in stock_registry() if sequences(each)]
RANGES, INTENSITIES = np.arange(7, dtype=np.float32), np.arange(3, dtype=np.float32)


@pytest.mark.parametrize("offset", [0, 4, 13])
def test_a_filled_loan_is_the_encoded_message(offset: int) -> None:
    layout = lay_out(LaserScan, {"header": Header(frame_id="laser"), "ranges": 7, "intensities": 3})
    buffer = bytearray(b"\xff" * (offset + layout.size))
    scan = layout.write(memoryview(buffer), offset)
    scan.ranges[:] = RANGES
    scan.intensities[:] = INTENSITIES
    whole = LaserScan(header=Header(frame_id="laser"), ranges=RANGES, intensities=INTENSITIES)
    assert layout.size == whole.encoded_size()
    assert buffer[offset:] == whole.encode()
    assert scan == whole


@pytest.mark.parametrize("message_type", LENDING, ids=lambda each: each.type_name)
@given(data=st.data())
@settings(PATIENT, max_examples=5)
def test_any_arrays_of_a_stock_message_can_be_lent(message_type: type[Message], data: st.DataObject) -> None:
    message = data.draw(messages(message_type))
    fields = {field.name: getattr(message, field.name) for field in fields_of(message_type)}
    lent = data.draw(st.sets(st.sampled_from(sorted(sequences(message_type)))))
    layout = lay_out(message_type, fields | {name: len(fields[name]) for name in lent})
    buffer = bytearray(layout.size)
    made = layout.write(memoryview(buffer))
    for name in lent:
        if len(fields[name]):
            getattr(made, name)[:] = fields[name]
    assert buffer == message.encode()


def test_arrays_before_and_after_the_loaned_one_are_written() -> None:
    fields = {"name": ["a", "bc"], "position": [1.0, 2.0], "velocity": 2, "effort": np.array([3.0])}
    layout = lay_out(JointState, fields)
    buffer = bytearray(layout.size)
    layout.write(memoryview(buffer)).velocity[:] = (5.0, 6.0)
    assert buffer == JointState(**{**fields, "velocity": [5.0, 6.0]}).encode()  # type: ignore[arg-type]


def test_fields_behind_a_loan_are_written() -> None:
    point = [PointField(name="x", datatype=PointField.FLOAT32, count=1)]
    layout = lay_out(PointCloud2, {"fields": point, "data": 5, "is_dense": True})
    buffer = bytearray(layout.size)
    cloud = layout.write(memoryview(buffer))
    cloud.data[:] = 9
    assert buffer == PointCloud2(fields=point, data=b"\x09" * 5, is_dense=True).encode()  # type: ignore[arg-type]


def test_the_loaned_elements_are_not_written() -> None:
    layout = lay_out(Image, {"data": 100})
    buffer = bytearray(b"\xaa" * layout.size)
    assert set(layout.write(memoryview(buffer)).data.tolist()) == {0xAA}


def test_a_large_loan_allocates_no_memory_for_its_elements() -> None:
    size = 6_000_000
    buffer = memoryview(bytearray(size + 1000))
    lay_out(Image, {"data": size}).write(buffer)  # makes the encoder
    tracemalloc.start()
    try:
        layout = lay_out(Image, {"data": size})
        image = layout.write(buffer)
        assert tracemalloc.get_traced_memory()[1] < 10_000
    finally:
        tracemalloc.stop()
    image.data[-1] = 7
    assert buffer[layout.size - 1] == 7


def test_nothing_lent_is_a_plain_message() -> None:
    layout = lay_out(LaserScan, {"ranges": RANGES})
    buffer = bytearray(layout.size)
    assert layout.write(memoryview(buffer)) == LaserScan(ranges=RANGES)
    assert buffer == LaserScan(ranges=RANGES).encode()


def test_no_elements_can_be_lent() -> None:
    layout = lay_out(LaserScan, {"ranges": 0})
    buffer = bytearray(layout.size)
    scan = layout.write(memoryview(buffer))
    scan.ranges[:] = []
    assert scan == LaserScan()
    assert buffer == LaserScan().encode()


def test_a_loan_needs_room() -> None:
    layout = lay_out(Image, {"data": 100})
    with pytest.raises(BufferTooSmall, match=f"needs {layout.size} bytes"):
        layout.write(memoryview(bytearray(layout.size - 1)))


def test_only_sequences_are_lent() -> None:
    with pytest.raises(FieldValueError, match=r"data: cannot lend -1 elements"):
        lay_out(Image, {"data": -1})
    with pytest.raises(FieldTypeError, match="only sequences are lent"):
        lay_out(Imu, {"orientation_covariance": 9})
    with pytest.raises(FieldTypeError, match="only sequences are lent"):
        lay_out(Image, {"data": True})
    with pytest.raises(FieldTypeError, match="height: expected uint32"):
        lay_out(Image, {"height": "tall", "data": 3})
