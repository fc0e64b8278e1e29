"""Compares two measurements of the same cases, such as runs with the same seed, by sign flips.

If both kinds of runs were alike, each difference could as well have the other sign. The share of all choices
of signs whose mean is at least as far from 0 as the one that was measured is the p-value (R. A. Fisher, The
Design of Experiments, 1935, section 21). No distribution is assumed.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

MAX_EXACT = 12
"""Up to this number of pairs, all choices of signs are tried; beyond, a sample."""
SAMPLE = 10_000
HALVINGS = 40
"""Steps of the search for an end of the interval."""

Array = NDArray[np.float64]


class TooFewPairs(ValueError):
    """There are so few pairs that no difference could be told from chance."""


class SignFlips:
    """All choices of signs of some differences, or a sample of them.

    Args:
        differences: of each pair, at least one.
    """

    def __init__(self, differences: Sequence[float] | Array) -> None:
        self.values = np.asarray(differences, float)
        if not len(self.values):
            raise TooFewPairs("there is no pair")
        signs = _signs(len(self.values))
        self._means, self._sums = signs @ self.values / len(self.values), signs.mean(axis=1)
        # Rounding must not decide on whether the measured signs count themselves.
        self._rounding = 1e-12 * max(1.0, float(np.abs(self.values).max()))

    def p_value(self, supposed: float = 0.0) -> float:
        """Return how probable a mean as far from a supposed one as this is, if that one is true."""
        reached = np.abs(self._means - supposed * self._sums)
        return float((reached >= abs(self.values.mean() - supposed) - self._rounding).mean())

    def confidence_interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the mean differences that the test does not refute at this level.

        Raises:
            TooFewPairs: there are too few pairs for this level: 6 are needed for 95 %.
        """
        if 2.0 ** (1 - len(self.values)) > 1.0 - level:
            raise TooFewPairs(f"{len(self.values)} pairs are too few for a confidence of {level:.0%}")
        mean, spread = float(self.values.mean()), float(np.ptp(self.values))
        return self._end(mean, mean - spread, 1.0 - level), self._end(mean, mean + spread, 1.0 - level)

    def _end(self, inside: float, outside: float, least_p: float) -> float:
        """Return the end of the interval between a mean that is not refuted and one that is."""
        for _ in range(HALVINGS):
            middle = (inside + outside) / 2
            if self.p_value(middle) > least_p:
                inside = middle
            else:
                outside = middle
        return (inside + outside) / 2


def _signs(pairs: int) -> Array:
    """Return choices of signs, the measured ones first: (choices, pairs)."""
    if pairs <= MAX_EXACT:
        return (1 - 2 * (np.arange(2**pairs)[:, None] >> np.arange(pairs) & 1)).astype(np.float64)
    signs = (2 * np.random.default_rng(0).integers(0, 2, (SAMPLE, pairs)) - 1).astype(np.float64)
    signs[0] = 1.0
    return signs
