"""Finds the sentence of a grammar that sounds most like what was heard.

It has the least edit distance between the phonemes that were heard and its own: by dynamic programming
(Wagner and Fischer, "The String-to-String Correction Problem", 1974) over the graph of all sentences.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.speech.order_grammar import (
    Optional,
    OrderGrammar,
    Part,
    PhraseChoice,
    PhraseRow,
    Word,
    WordSlot,
)
from robbie_robots.workers.speech.pronunciation import MAX_PHONEMES, phonemes, substitution_cost

MAX_NODES = 50_000
"""Phonemes of all sentences together; a larger grammar takes too long to be searched."""
CLOSE = 1e-9


class GrammarTooLarge(ValueError):
    """The sentences of a grammar have more phonemes together than can be searched in time."""


@dataclass(frozen=True)
class _Node:
    """A phoneme of the graph, or a joint ("") that only brings ways together.

    Attributes:
        phoneme: of the dictionary; "" for a joint.
        before: indices of the nodes from which a way leads here.
        word: the word that ends here; "" within a word.
    """

    phoneme: str
    before: tuple[int, ...]
    word: str = ""


class NearestSentence:
    """The phonemes of all sentences of a grammar as a graph.

    Args:
        grammar: the sentences.
        pronounce: returns a word's phonemes, separated by spaces, or None.

    Raises:
        GrammarTooLarge: see there.
    """

    def __init__(self, grammar: OrderGrammar, pronounce: Callable[[str], str | None]) -> None:
        self._pronounce = pronounce
        self._nodes = [_Node("", ())]
        self._ends = [self._add(part, 0) for _, part in grammar.sentences]

    def find(self, heard: Sequence[str]) -> str:
        """Return the words of the sentence whose phonemes are the fewest changes away from those heard."""
        heard = heard[:MAX_PHONEMES]
        costs = self._costs(heard)
        end = min(self._ends, key=lambda node: float(costs[node][-1]))
        return " ".join(reversed(self._way_back(costs, heard, end)))

    def _add(self, part: Part, start: int) -> int:
        """Add a part behind a node; return the node at its end."""
        match part:
            case Word(text):
                return self._add_word(text, start)
            case PhraseRow(parts):
                for each in parts:
                    start = self._add(each, start)
                return start
            case PhraseChoice(parts):
                return self._node("", *(self._add(each, start) for each in parts))
            case Optional(inner):
                return self._node("", start, self._add(inner, start))
            case WordSlot(_, choices):
                words = (PhraseRow(tuple(map(Word, choice.split()))) for choice in choices)
                return self._node("", *(self._add(each, start) for each in words))

    def _add_word(self, text: str, start: int) -> int:
        sounds = phonemes([text], self._pronounce)
        for sound in sounds[:-1]:
            start = self._node(sound, start)
        return self._node(sounds[-1], start, word=text)

    def _node(self, phoneme: str, *before: int, word: str = "") -> int:
        if len(self._nodes) >= MAX_NODES:
            raise GrammarTooLarge(f"the sentences have more than {MAX_NODES} phonemes; leave some out")
        self._nodes.append(_Node(phoneme, before, word))
        return len(self._nodes) - 1

    def _costs(self, heard: Sequence[str]) -> list[NDArray[np.float64]]:
        """Return for each node the least cost of a way to it and the first 0, 1, ... phonemes heard."""
        insertions = np.arange(len(heard) + 1, dtype=float)
        substitutions = _substitutions({node.phoneme for node in self._nodes}, heard)
        costs = [insertions]
        for node in self._nodes[1:]:
            reached = costs[node.before[0]]
            for other in node.before[1:]:
                reached = np.minimum(reached, costs[other])
            if node.phoneme:
                after = reached + 1.0
                after[1:] = np.minimum(after[1:], reached[:-1] + substitutions[node.phoneme])
                reached = np.minimum.accumulate(after - insertions) + insertions
            costs.append(reached)
        return costs

    def _way_back(self, costs: list[NDArray[np.float64]], heard: Sequence[str], end: int) -> list[str]:
        """Return the words of the way with the least cost, the last one first."""
        words, index, at = [], end, len(heard)
        while index:
            node, here = self._nodes[index], float(costs[index][at])
            before = min(node.before, key=lambda each, at=at: float(costs[each][at]))  # type: ignore[misc]
            if not node.phoneme:
                index = before
                continue
            if at and abs(float(costs[index][at - 1]) + 1.0 - here) < CLOSE:
                at -= 1
                continue
            if at:
                cost = substitution_cost(node.phoneme, heard[at - 1])
                nearest = min(node.before, key=lambda each, at=at: float(costs[each][at - 1]))  # type: ignore[misc]
                if abs(float(costs[nearest][at - 1]) + cost - here) < CLOSE:
                    before, at = nearest, at - 1
            words += [node.word] * bool(node.word)
            index = before
        return words


def _substitutions(sounds: set[str], heard: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Return for each phoneme of the grammar the cost of hearing it as each one that was heard."""
    return {sound: np.array([substitution_cost(sound, each) for each in heard]) for sound in sounds}
