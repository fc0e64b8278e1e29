"""Reads the journals of a campaign as streams, and keeps figures of them."""

from array import array
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from tools.journal import read_journal

Key = tuple[int, int]
"""Incarnation and number of a message of one publisher."""


@dataclass
class Published:
    """One publisher's journal over all incarnations."""

    intended: dict[int, int] = field(default_factory=dict)
    """Count of numbers that each incarnation tried to publish."""
    refused: set[Key] = field(default_factory=set)
    uncertain: set[Key] = field(default_factory=set)
    """Numbers that the process was about to publish when it died: they may or may not have been published."""
    last_accepted: Key = (0, -1)

    @property
    def accepted(self) -> int:
        """Number of messages that were certainly accepted."""
        return sum(self.intended.values()) - len(self.refused) - len(self.uncertain)

    def may_exist(self, key: Key) -> bool:
        """Return whether a message with this number can exist."""
        incarnation, number = key
        return 0 <= number < self.intended.get(incarnation, 0) and key not in self.refused


@dataclass
class Handled:
    """One subscriber's journal about one publisher's messages, over all incarnations."""

    entered: int = 0
    left: int = 0
    last_key: Key = (0, -1)
    last_sequence: int = 0
    uncertain: set[Key] = field(default_factory=set)
    """Received numbers for which the publisher does not know whether it published them."""


@dataclass
class ModuleRecord:
    """The journal of one module."""

    published: Published = field(default_factory=Published)
    handled: dict[str, Handled] = field(default_factory=lambda: defaultdict(Handled))
    begun: list[tuple[int, int]] = field(default_factory=list)
    """Each incarnation's number and when it began (ns)."""
    worked_ns: list[int] = field(default_factory=list)
    """When each incarnation handled or published its first message."""
    entered_ns: "array[int]" = field(default_factory=lambda: array("q"))
    """When each handler was entered."""
    latency_ns: "array[int]" = field(default_factory=lambda: array("q"))
    """Time from the publication of each message to its handler."""
    violations: list[str] = field(default_factory=list)


def read_published(path: Path, record: ModuleRecord) -> None:
    """Read what a module published. Do this for all modules before any `read_handled`."""
    incarnation, pending = 0, None
    published = record.published
    for words in read_journal(path):
        kind = words[0]
        if kind == "S":
            if pending is not None:
                published.uncertain.add(pending)
            pending = None
            if int(words[1]) <= incarnation:
                record.violations.append(f"{path.stem} begins incarnation {words[1]} after {incarnation}")
            incarnation = int(words[1])
            record.begun.append((incarnation, int(words[2])))
        elif kind == "I":
            pending = (incarnation, int(words[1]))
            published.intended[incarnation] = pending[1] + 1
        elif kind in "AR" and pending is not None:
            if kind == "R":
                published.refused.add(pending)
            else:
                published.last_accepted = pending
            pending = None
    if pending is not None:
        published.uncertain.add(pending)


def read_handled(path: Path, record: ModuleRecord, publishers: dict[str, Published]) -> None:
    """Read what a module handled, and check the order and wholeness of every message.

    The global sequence must increase strictly over all incarnations and publishers, and the numbers must
    increase strictly for each publisher. So no message comes twice or out of order.
    """
    last_sequence, current, has_worked = 0, None, False
    tell = record.violations.append
    for words in read_journal(path):
        kind = words[0]
        if kind == "S":
            current, has_worked = None, False
            continue
        if not has_worked and kind in "AE":
            has_worked = True
            record.worked_ns.append(int(words[-1]))
        if kind == "E":
            sequence, sender, key = int(words[1]), words[2], (int(words[3]), int(words[4]))
            if sequence <= last_sequence:
                tell(f"{path.stem}: sequence {sequence} after {last_sequence}: twice or out of order")
            last_sequence = sequence
            if words[5] != "1":
                tell(f"{path.stem}: message {sequence} of {sender} is damaged")
            current = record.handled[sender]
            _enter(path.stem, current, sender, key, publishers.get(sender), tell)
            current.last_sequence = sequence
            record.entered_ns.append(int(words[7]))
            record.latency_ns.append(int(words[7]) - int(words[6]))
        elif kind == "L" and current is not None:
            current.left += 1
            if words[2] != "1":
                tell(f"{path.stem}: message {words[1]} changed while it was handled")


def _enter(
    name: str,
    handled: Handled,
    sender: str,
    key: Key,
    publisher: Published | None,
    tell: Callable[[str], None],
) -> None:
    if publisher is None or not publisher.may_exist(key):
        tell(f"{name}: {sender} {key} was handled, but never published")
        return
    if key <= handled.last_key:
        tell(f"{name}: {sender} {key} after {handled.last_key}: twice or out of order")
    handled.last_key = key
    handled.entered += 1
    if key in publisher.uncertain:
        handled.uncertain.add(key)
