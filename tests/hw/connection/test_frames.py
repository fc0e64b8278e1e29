"""A reader of frames finds every whole frame, however the stream is cut or damaged."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from tests.hw._support.beacon import BeaconFrames, frame

noise = st.binary(max_size=60)


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    places = sorted({cut % (len(data) + 1) for cut in cuts} | {0, len(data)})
    return [data[begin:end] for begin, end in pairwise(places)]


@given(st.lists(st.integers(0, 2**32 - 1), max_size=8), st.lists(st.integers(0, 200), max_size=6))
def test_whole_frames_are_found_in_pieces_of_any_length(numbers: list[int], cuts: list[int]) -> None:
    reader = BeaconFrames()
    sent = [frame(number) for number in numbers]
    assert [one for piece in pieces(b"".join(sent), cuts) for one in reader.feed(piece)] == sent
    assert (reader.damaged, reader.skipped_bytes) == (0, 0)


@given(st.lists(noise, min_size=1, max_size=6))
def test_every_byte_is_in_a_frame_or_counted_as_skipped(parts: list[bytes]) -> None:
    reader = BeaconFrames()
    found = sum(len(one) for part in parts for one in reader.feed(part))
    reader.forget()
    assert found + reader.skipped_bytes == sum(map(len, parts))


@given(noise.filter(lambda data: b"\xaa" not in data), st.integers(0, 2**32 - 1))
def test_frame_behind_noise_is_found(before: bytes, number: int) -> None:
    assert BeaconFrames().feed(before + frame(number)) == [frame(number)]


@given(st.integers(0, 11), st.integers(1, 255))
def test_reader_is_in_step_again_within_two_frames_of_a_changed_byte(place: int, change: int) -> None:
    damaged = bytearray(frame(1))
    damaged[place] ^= change
    reader = BeaconFrames()
    # The longest length that a damaged byte may tell is that of a few frames: they arrive late, not never.
    found = reader.feed(bytes(damaged) + b"".join(frame(number) for number in range(2, 8)))
    assert found[-5:] == [frame(number) for number in range(3, 8)]


def test_frame_within_what_a_damaged_length_covers_is_found() -> None:
    claims_more = b"\xaa\x55" + bytes([30])
    reader = BeaconFrames()
    assert reader.feed(claims_more + frame(1) + frame(2)) == []
    assert reader.feed(frame(3)) == [frame(1), frame(2), frame(3)]
    assert reader.damaged == 1
