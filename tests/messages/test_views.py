"""Decoded arrays are views, and while one lives, the object that was decoded from lives."""

import gc
import mmap
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from robbie_mp.messages import (
    DecodeError,
    Header,
    Imu,
    LaserScan,
    Message,
    Odometry,
    message_type_from_schema,
)

SCAN = LaserScan(header=Header(frame_id="laser"), ranges=np.arange(4), intensities=np.arange(2))


@pytest.fixture(autouse=True)
def no_garbage_collection() -> Iterator[None]:
    """Objects must go as soon as nothing refers to them: the collector may run much later."""
    gc.disable()
    yield
    gc.enable()


def test_arrays_are_views_of_the_buffer() -> None:
    buffer = bytearray(SCAN.encode())
    scan = LaserScan.decode(memoryview(buffer))
    buffer[-8:-4] = np.float32(7).tobytes()  # the first of the two intensities
    assert scan.intensities.tolist() == [7.0, 1.0]


def test_views_are_as_writable_as_the_buffer() -> None:
    buffer = memoryview(bytearray(SCAN.encode()))
    assert LaserScan.decode(buffer).ranges.flags.writeable
    assert not LaserScan.decode(buffer.toreadonly()).ranges.flags.writeable
    assert not LaserScan.decode(bytes(buffer)).ranges.flags.writeable


def test_views_outlive_the_message_and_pin_the_memoryview() -> None:
    view = memoryview(SCAN.encode())
    pin = weakref.ref(view)
    scan = LaserScan.decode(view)
    del view
    ranges, part = scan.ranges, scan.intensities[1:]
    del scan
    assert pin() is not None
    del ranges
    assert pin() is not None
    assert part.tolist() == [1.0]
    del part
    assert pin() is None


def test_views_pin_an_array_that_was_decoded_from() -> None:
    whole: Any = np.frombuffer(SCAN.encode(), np.uint8)  # numpy declares a Buffer only since Python 3.12
    pin = weakref.ref(whole)
    ranges = LaserScan.decode(whole).ranges
    del whole
    assert pin() is not None
    del ranges
    assert pin() is None


@pytest.mark.parametrize("message", [Header(frame_id="map"), LaserScan(), Odometry().pose.pose])
def test_a_message_without_elements_in_arrays_keeps_nothing(message: Message) -> None:
    view = memoryview(message.encode())
    pin = weakref.ref(view)
    decoded = type(message).decode(view)
    del view
    assert pin() is None
    assert decoded == message


def test_a_failed_decode_keeps_nothing() -> None:
    view = memoryview(SCAN.encode()[:-1])
    pin = weakref.ref(view)
    try:
        LaserScan.decode(view)
    except DecodeError as error:
        assert "intensities" in str(error)
    del view
    assert pin() is None


def test_fixed_arrays_pin_too() -> None:
    view = memoryview(Imu().encode())
    pin = weakref.ref(view)
    covariance = Imu.decode(view).orientation_covariance
    del view
    assert pin() is not None and len(covariance) == 9
    del covariance
    assert pin() is None


def test_a_pinned_memoryview_cannot_be_released() -> None:
    view = memoryview(bytearray(SCAN.encode()))
    scan = LaserScan.decode(view)
    with pytest.raises(BufferError):
        view.release()
    del scan
    view.release()


@pytest.mark.parametrize("offset", range(9))
def test_views_are_right_wherever_the_buffer_begins(offset: int) -> None:
    message_type = message_type_from_schema(
        "test_msgs/msg/Arrays", "uint8 a\nfloat64[] b\nint16[] c\nfloat32[3] d"
    )
    message = message_type(a=1, b=np.arange(5.0), c=np.arange(3), d=[1, 2, 3])
    memory = bytearray(offset) + message.encode()
    assert message_type.decode(memoryview(memory)[offset:]) == message


def test_messages_are_decoded_from_mapped_memory() -> None:
    with mmap.mmap(-1, mmap.PAGESIZE) as memory, memoryview(memory) as view:
        size = SCAN.encode_into(view, 64)
        assert LaserScan.decode(view[64 : 64 + size]) == SCAN


def test_a_message_can_let_go_of_its_arrays() -> None:
    view = memoryview(SCAN.encode())
    pin = weakref.ref(view)
    scan = LaserScan.decode(view)
    del view
    scan.forget_arrays()
    assert pin() is None
    assert scan == LaserScan(header=Header(frame_id="laser"))
