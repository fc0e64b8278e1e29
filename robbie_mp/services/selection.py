"""Which messages are recorded."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from robbie_mp.messages.registry import full_name

WILDCARDS = frozenset("*?[")


def type_pattern(text: str) -> str:
    """Return the pattern that is meant: `LaserScan` stands for the type of any package."""
    if "/" not in text and WILDCARDS.isdisjoint(text):
        return f"*/{text}"
    return full_name(text)


class Selection:
    """Types and topics that are wanted, by shell patterns, and what is left out of them.

    Args:
        types: patterns for full type names; short names stand for their types.
        topics: patterns for topics; '' is a message without a topic.
        exclude: patterns of either kind.
    """

    def __init__(self, types: Sequence[str], topics: Sequence[str], exclude: Sequence[str]):
        self._pairs = [(type_pattern(one), topic) for one in types for topic in topics]
        self._exclude_types = [type_pattern(one) for one in exclude]
        self._exclude_topics = list(exclude)
        self._unmatched = dict.fromkeys(self._pairs)

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Patterns of type and topic to subscribe to."""
        return list(self._pairs)

    @property
    def unmatched(self) -> list[str]:
        """Pairs of patterns that have not matched anything yet, for people."""
        return [f"type {one!r}, topic {topic!r}" for one, topic in self._unmatched]

    def is_subscribed(self, type_name: str, topic: str) -> bool:
        """Whether messages of a type on a topic come, even if they are excluded then."""
        return any(matches(pair, type_name, topic) for pair in self._pairs)

    def wants(self, type_name: str, topic: str) -> bool:
        """Whether messages of a type on a topic are to be recorded."""
        matching = [pair for pair in self._pairs if matches(pair, type_name, topic)]
        for pair in matching:
            self._unmatched.pop(pair, None)
        return bool(matching) and not self._excludes(type_name, topic)

    def _excludes(self, type_name: str, topic: str) -> bool:
        return any(fnmatchcase(type_name, one) for one in self._exclude_types) or any(
            fnmatchcase(topic, one) for one in self._exclude_topics
        )


def matches(pair: tuple[str, str], type_name: str, topic: str) -> bool:
    """Whether a type and a topic match a pair of patterns."""
    return fnmatchcase(type_name, pair[0]) and fnmatchcase(topic, pair[1])
