"""How far apart two utterances sound: an edit distance of their phonemes."""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

VOWELS = frozenset(["AA", "AE", "AH", "AO", "AW", "AY", "EH", "ER", "EY", "IH", "IY", "OW", "OY", "UH", "UW"])
CONSONANTS = frozenset([
    "B", "CH", "D", "DH", "F", "G", "HH", "JH", "K", "L", "M", "N",
    "NG", "P", "R", "S", "SH", "T", "TH", "V", "W", "Y", "Z", "ZH",
])  # fmt: skip
NEAR = (
    "P B", "T D", "K G", "F V", "TH DH", "S Z", "SH ZH", "CH JH", "M N NG", "L R W", "IH IY", "UH UW",
    "AA AO AH", "EH AE", "ER R",
)  # fmt: skip
"""Phonemes of the CMU dictionary that noise makes alike: they differ mostly in voicing or length."""
NEAR_PAIRS = frozenset(frozenset(pair) for group in NEAR for pair in combinations(group.split(), 2))
NEAR_COST, VOWEL_COST, OTHER_COST = 0.4, 0.6, 1.0
MAX_PHONEMES = 400
"""Longer utterances are compared by their beginnings."""


def phonemes(words: Sequence[str], pronounce: Callable[[str], str | None]) -> list[str]:
    """Return the phonemes of words; of a word that the dictionary does not know, its letters.

    Args:
        words: in lower case.
        pronounce: returns a word's phonemes, separated by spaces, or None.
    """
    found: list[str] = []
    for word in words:
        told = pronounce(word)
        found += told.split() if told else [f"?{letter}" for letter in word]
    return found[:MAX_PHONEMES]


def distance(one: Sequence[str], other: Sequence[str]) -> float:
    """Return the cost of changing one list of phonemes into the other, for each one of the longer: 0 to 1."""
    if not one and not other:
        return 0.0
    if not one or not other:
        return 1.0
    costs = _substitutions(one, other)
    previous = np.arange(len(other) + 1, dtype=float)
    for row in range(1, len(one) + 1):
        current = np.minimum(previous[1:] + 1.0, previous[:-1] + costs[row - 1])
        # Insertions may follow one another: the running least of what each place costs without its own.
        steps = np.arange(len(other) + 1, dtype=float)
        current = np.concatenate([[float(row)], current])
        previous = np.minimum.accumulate(current - steps) + steps
    return float(previous[-1]) / max(len(one), len(other))


def _substitutions(one: Sequence[str], other: Sequence[str]) -> NDArray[np.float64]:
    return np.array([[substitution_cost(a, b) for b in other] for a in one])


def substitution_cost(one: str, other: str) -> float:
    """Return the cost of hearing one phoneme as another one: 0 (the same) to 1."""
    if one == other:
        return 0.0
    if frozenset((one, other)) in NEAR_PAIRS:
        return NEAR_COST
    return VOWEL_COST if one in VOWELS and other in VOWELS else OTHER_COST
