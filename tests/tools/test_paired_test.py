"""Sign flips tell a difference between paired runs from chance."""

import numpy as np
import pytest

from tools.trials.devices.paired_test import MAX_EXACT, SignFlips, TooFewPairs


def test_p_value_counts_the_choices_of_signs_that_are_at_least_as_far_from_zero() -> None:
    # Of eight choices, only the measured one and its opposite reach a mean of 2.
    assert SignFlips([1.0, 2.0, 3.0]).p_value() == pytest.approx(2 / 8)
    # +1, +2, -3 makes 0: each of the eight choices reaches it.
    assert SignFlips([1.0, 2.0, -3.0]).p_value() == 1.0
    assert SignFlips([0.0, 0.0, 0.0]).p_value() == 1.0


def test_interval_holds_the_true_difference_as_often_as_it_says() -> None:
    chance = np.random.default_rng(5)
    held = 0
    for _ in range(200):
        low, high = SignFlips(chance.normal(0.3, 1.0, 8)).confidence_interval()
        held += low <= 0.3 <= high
    assert 0.90 <= held / 200 <= 0.99


def test_interval_and_p_value_agree_also_where_signs_are_sampled() -> None:
    chance = np.random.default_rng(6)
    for count in (8, MAX_EXACT + 4):
        values = chance.normal(1.0, 1.0, count)
        flips = SignFlips(values)
        low, high = flips.confidence_interval()
        assert low < values.mean() < high
        assert flips.p_value(low - 0.01) < 0.05 < flips.p_value(low + 0.01)
        assert flips.p_value(high + 0.01) < 0.05 < flips.p_value(high - 0.01)


def test_too_few_pairs_are_refused() -> None:
    with pytest.raises(TooFewPairs):
        SignFlips([1.0, 2.0, 3.0, 4.0, 5.0]).confidence_interval()
    with pytest.raises(TooFewPairs):
        SignFlips([])
