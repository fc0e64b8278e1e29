"""Frames are found between noise, and damage costs no intact frame."""

from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.microstrain.mip import MipFraming, set_idle
from robbie_robots.hw.xsens.xbus import XbusFraming, XbusMessage, message

ONE = message(0x36, b"one")
TWO = message(0x36, b"two")


def test_frame_cut_into_single_bytes_is_found_once() -> None:
    decoder = FrameDecoder(XbusFraming())
    found = [frame for byte in ONE for frame in decoder.feed(bytes([byte]))]
    assert found == [XbusMessage(0x36, b"one")]
    assert (decoder.frames, decoder.damaged, decoder.skipped_bytes) == (1, 0, 0)


def test_noise_between_frames_is_skipped_and_counted() -> None:
    decoder = FrameDecoder(XbusFraming())
    found = decoder.feed(b"noise" + ONE + b"\xfa\x00" + TWO)
    assert [frame.data for frame in found] == [b"one", b"two"]
    assert decoder.skipped_bytes == 7


def test_damaged_frame_costs_only_itself() -> None:
    decoder = FrameDecoder(XbusFraming())
    damaged = ONE[:5] + b"X" + ONE[6:]
    assert [frame.data for frame in decoder.feed(ONE + damaged + TWO)] == [b"one", b"two"]
    assert decoder.damaged == 1


def test_damaged_length_holds_up_the_stream_for_two_frames_at_most() -> None:
    decoder = FrameDecoder(XbusFraming())
    promises_too_much = b"\xfa\xff\x36\xf0"
    assert decoder.feed(promises_too_much + ONE) == []
    assert [frame.data for frame in decoder.feed(TWO)] == [b"one", b"two"]
    assert decoder.damaged == 1


def test_long_frame_that_arrives_slowly_is_not_given_up() -> None:
    decoder = FrameDecoder(XbusFraming())
    # One frame inside another is not enough to give the outer one up.
    outer = message(0x36, b"a" + ONE + b"b")
    found = [frame for byte in outer for frame in decoder.feed(bytes([byte]))]
    assert [frame.data for frame in found] == [b"a" + ONE + b"b"]


def test_reset_forgets_an_unfinished_frame() -> None:
    decoder = FrameDecoder(XbusFraming())
    decoder.feed(ONE[:-1])
    decoder.reset()
    assert decoder.feed(TWO) == [XbusMessage(0x36, b"two")]
    assert decoder.skipped_bytes == len(ONE) - 1


@given(st.binary(max_size=200), st.integers(1, 20))
def test_every_byte_is_in_a_frame_or_skipped_or_waiting(noise: bytes, size: int) -> None:
    decoder = FrameDecoder(MipFraming())
    data = noise + set_idle() * 2
    for position in range(0, len(data), size):
        decoder.feed(data[position : position + size])
    before = decoder.skipped_bytes
    decoder.reset()
    assert decoder.frames == 2 or noise
    assert before <= decoder.skipped_bytes <= len(data)
