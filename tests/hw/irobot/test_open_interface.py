"""The Open Interface's commands and stream, with the examples of the maker's specification."""

import pytest

from robbie_robots.hw.framing import FrameDecoder
from robbie_robots.hw.irobot import open_interface as oi


def test_right_wheel_comes_first_in_direct_drive() -> None:
    assert oi.drive_direct(left_mm_per_s=-1, right_mm_per_s=256) == bytes.fromhex("91 01 00 FF FF")


def test_example_of_the_specification_for_the_stream() -> None:
    assert oi.stream([29, 13]) == bytes.fromhex("94 02 1D 0D")
    decoder = FrameDecoder(oi.StreamFraming([29, 13]))
    found = decoder.feed(bytes.fromhex("13 05 1D 02 19 0D 00 A3"))
    # The bytes say 0219 hex (537).
    assert found == [{"cliff_front_left_signal": 0x219, "virtual_wall": 0}]


def test_header_in_the_data_does_not_mislead_the_decoder() -> None:
    decoder = FrameDecoder(oi.StreamFraming([22]))
    frame = bytes([0x13, 3, 22, 0x13, 0x03])
    frame += bytes([oi.checksum(frame)])
    tail = frame[3:]
    assert decoder.feed(tail + frame * 3) == [{"voltage_mv": 0x1303}] * 3


def test_frame_with_other_packets_is_damaged() -> None:
    decoder = FrameDecoder(oi.StreamFraming([7, 13]))
    frame = bytes([0x13, 4, 7, 0, 8, 0])
    assert decoder.feed(frame + bytes([oi.checksum(frame)])) == []
    assert decoder.damaged == 1


@pytest.mark.parametrize(
    ("group", "size"),
    [(0, 26), (1, 10), (2, 6), (3, 10), (4, 14), (5, 12), (6, 52), (100, 80), (101, 28), (106, 12), (107, 9)],
)
def test_groups_have_the_sizes_of_the_specification(group: int, size: int) -> None:
    assert oi.struct_of(group).size == size


def test_group_of_all_packets_yields_signed_values() -> None:
    assert {packet.name for packet in oi.packets_of(100)} >= {"temperature_c", "stasis"}
    decoder = FrameDecoder(oi.StreamFraming([3]))
    # Charging state 0, 14.4 V, -500 mA, -3 degrees Celsius, 2000 of 2696 mAh.
    frame = bytes.fromhex("13 0B 03 00 3840 FE0C FD 07D0 0A88")
    (values,) = decoder.feed(frame + bytes([oi.checksum(frame)]))
    assert list(values.values()) == [0, 14400, -500, -3, 2000, 2696]


def test_bumpers_and_wheel_drops_are_on_their_sides() -> None:
    assert oi.Bumps(0b0101) == oi.Bumps.BUMP_RIGHT | oi.Bumps.WHEEL_DROP_RIGHT


def test_song_is_notes_and_durations() -> None:
    assert oi.song(0, [(60, 32), (67, 16)]) == bytes([140, 0, 2, 60, 32, 67, 16])
    assert oi.play(0) == bytes([141, 0])
    assert oi.leds(oi.Leds.DOCK | oi.Leds.SPOT, 255, 128) == bytes([139, 6, 255, 128])


def test_values_out_of_range_are_refused_by_name() -> None:
    with pytest.raises(oi.OpenInterfaceError, match="left_mm_per_s must be between -500 and 500, not 501"):
        oi.drive_direct(501, 0)
    with pytest.raises(oi.OpenInterfaceError, match="number of notes"):
        oi.song(0, [])
    with pytest.raises(oi.OpenInterfaceError, match="no sensor packet 99"):
        oi.stream([99])
    with pytest.raises(oi.OpenInterfaceError, match="bytes of a frame must be between 4 and 172"):
        oi.stream([100, 100, 100])
