"""Utterances in sound; here all that is loud is speech."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from robbie_robots.workers.speech.utterances import CHUNK, UtteranceFinder


def loudness(chunk: NDArray[np.int16]) -> float:
    return float(np.abs(chunk.astype(float)).mean() > 100)


def sound(*chunks: int) -> NDArray[np.int16]:
    """Return silence and speech in turn, in chunks."""
    return np.concatenate(
        [np.full(count * CHUNK, 1000 * (i % 2), np.int16) for i, count in enumerate(chunks)]
    )


@pytest.fixture
def finder() -> UtteranceFinder:
    return UtteranceFinder(loudness)


def test_utterance_goes_from_before_the_first_word_to_the_pause(finder: UtteranceFinder) -> None:
    (utterance,) = finder.add(sound(30, 20, 40))
    loud = np.flatnonzero(utterance)
    assert len(loud) == 20 * CHUNK
    assert loud[0] == 8 * CHUNK  # 0.25 s
    assert len(utterance) == (8 + 20 + 19) * CHUNK
    assert not finder.hears_speech


def test_short_pauses_belong_to_the_utterance(finder: UtteranceFinder) -> None:
    assert finder.add(sound(10, 10, 10, 10)) == []
    assert finder.hears_speech
    (utterance,) = finder.add(sound(30))
    assert np.count_nonzero(utterance) == 20 * CHUNK


def test_two_utterances_are_told_apart(finder: UtteranceFinder) -> None:
    assert [np.count_nonzero(each) for each in finder.add(sound(10, 10, 30, 15, 30))] == [
        10 * CHUNK,
        15 * CHUNK,
    ]


def test_noises_are_counted_and_dropped(finder: UtteranceFinder) -> None:
    assert finder.add(sound(10, 2, 30)) == []
    assert finder.too_short == 1


def test_endless_speech_is_given_up_and_counted_in_bounded_memory(finder: UtteranceFinder) -> None:
    for _ in range(50):
        assert finder.add(sound(0, 100)) == []
        assert len(finder._chunks) <= 320
    assert finder.add(sound(30)) == []
    assert finder.too_long == 1
    assert len(finder.add(sound(10, 20, 30))) == 1


def test_what_is_forgotten_is_no_part_of_an_utterance(finder: UtteranceFinder) -> None:
    finder.add(sound(10, 20))
    finder.forget()
    assert finder.add(sound(40)) == []
    assert finder.too_short == 0


@given(st.lists(st.integers(1, 3000), min_size=1, max_size=40))
def test_utterances_do_not_depend_on_the_blocks_in_which_sound_comes(lengths: list[int]) -> None:
    whole = sound(20, 30, 30, 10, 30)
    in_one = UtteranceFinder(loudness).add(whole)
    finder, found, at = UtteranceFinder(loudness), [], 0
    for length in [*lengths, len(whole)]:
        found += finder.add(whole[at : at + length])
        at += length
    assert len(found) == len(in_one)
    for one, other in zip(found, in_one, strict=True):
        np.testing.assert_array_equal(one, other)
