"""How far apart utterances sound."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.workers.speech.pronunciation import CONSONANTS, VOWELS, distance, phonemes

DICTIONARY = {"cup": "K AH P", "cap": "K AE P", "cub": "K AH B"}
SOUNDS = st.lists(st.sampled_from(sorted(VOWELS | CONSONANTS)), max_size=12)


def apart(one: str, other: str) -> float:
    return distance(phonemes(one.split(), DICTIONARY.get), phonemes(other.split(), DICTIONARY.get))


def test_equal_words_are_not_apart() -> None:
    assert apart("cup cap", "cup cap") == 0.0


def test_similar_sounds_cost_less_than_others() -> None:
    assert apart("cup", "cub") == pytest.approx(0.4 / 3)
    assert apart("cup", "cap") == pytest.approx(0.6 / 3)
    assert distance(["K", "AH", "P"], ["K", "AH", "S"]) == pytest.approx(1 / 3)


def test_missing_sounds_count_one_each() -> None:
    assert distance(["K", "AH", "P"], ["K"]) == pytest.approx(2 / 3)
    assert distance(["AH"], ["K", "AH", "P"]) == pytest.approx(2 / 3)
    assert distance([], ["K"]) == 1.0
    assert distance([], []) == 0.0


def test_unknown_words_are_compared_by_letters() -> None:
    assert phonemes(["xyz"], DICTIONARY.get) == ["?x", "?y", "?z"]
    assert apart("xyz", "xyz") == 0.0
    assert apart("xyz", "cup") == 1.0


@given(SOUNDS, SOUNDS)
def test_distance_is_the_same_both_ways_and_between_0_and_1(one: list[str], other: list[str]) -> None:
    assert 0.0 <= distance(one, other) <= 1.0
    assert distance(one, other) == pytest.approx(distance(other, one))
    assert distance(one, one) == 0.0
