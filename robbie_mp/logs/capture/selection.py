"""Selects the messages to record."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

from typing_extensions import Self

from robbie_mp.messages.registry import full_name

WILDCARDS = frozenset("*?[")


def type_pattern(text: str) -> str:
    """Return the pattern that a user means: `LaserScan` stands for that type in any package."""
    if "/" not in text and WILDCARDS.isdisjoint(text):
        return f"*/{text}"
    return full_name(text)


class TypeAndTopic(NamedTuple):
    """Shell patterns for the full name of a type and for a topic; both must match."""

    type: str
    topic: str

    def matches(self, type_name: str, topic: str) -> bool:
        """Whether a type and a topic match."""
        return fnmatchcase(type_name, self.type) and fnmatchcase(topic, self.topic)


class Selection:
    """The wanted types and topics, and those excluded from them.

    Args:
        wanted: pairs of patterns, by the name the user gave; one matching pair of a name is enough.
        exclude: patterns for types or topics.
    """

    def __init__(self, wanted: dict[str, list[TypeAndTopic]], exclude: Sequence[str]):
        self._wanted = wanted
        self._excluded = _either(exclude)
        self.unmatched = dict.fromkeys(wanted)
        """Requested names that have matched nothing yet."""

    @classmethod
    def by_types_and_topics(cls, types: Sequence[str], topics: Sequence[str], exclude: Sequence[str]) -> Self:
        """Select messages that match one of the types and one of the topics."""
        pairs = [(one, topic) for one in types for topic in topics]
        wanted = {
            f"type {one!r}, topic {topic!r}": [TypeAndTopic(type_pattern(one), topic)] for one, topic in pairs
        }
        return cls(wanted, exclude)

    @classmethod
    def by_either(cls, patterns: Sequence[str], exclude: Sequence[str]) -> Self:
        """Select messages of which the type or the topic matches one of the patterns."""
        return cls({repr(pattern): _either([pattern]) for pattern in patterns}, exclude)

    @property
    def pairs(self) -> list[TypeAndTopic]:
        """The pairs to subscribe to."""
        return list(dict.fromkeys(pair for pairs in self._wanted.values() for pair in pairs))

    def is_subscribed(self, type_name: str, topic: str) -> bool:
        """Whether messages of a type on a topic are received, even if they are then excluded."""
        return any(pair.matches(type_name, topic) for pair in self.pairs)

    def wants(self, type_name: str, topic: str) -> bool:
        """Whether messages of a type on a topic are to be recorded."""
        matching = [
            name
            for name, pairs in self._wanted.items()
            if any(pair.matches(type_name, topic) for pair in pairs)
        ]
        for name in matching:
            self.unmatched.pop(name, None)
        return bool(matching) and not any(pair.matches(type_name, topic) for pair in self._excluded)


def _either(patterns: Sequence[str]) -> list[TypeAndTopic]:
    """Return pairs of which at least one matches if a pattern matches the type or the topic."""
    return [
        pair for one in patterns for pair in (TypeAndTopic(type_pattern(one), "*"), TypeAndTopic("*", one))
    ]
