"""The part of the campaign's robot with latched topics: publishers, subscribers, and the verdict on them.

Lines of their journals (see `tools.journal`), where a topic is the name of its publisher:

    S incarnation t                             a process has started
    I number t                                  the publisher is about to publish this number
    A number t                                  `publish` accepted it
    R number t                                  `publish` refused it
    E sequence topic incarnation number t       a subscriber's handler was entered

A frequent topic that is not latched, `BEAT`, shows how far a subscriber is: the core gives each module its
messages in one order. So a subscriber that handles a beat must have handled, since its process started, the
newest latched message that was routed before both its start and the beat, or a newer one.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robbie_mp import EncodedMessage, Message, MessageHandling, Module, setting
from robbie_mp.messages.primitives import Array, uint8, uint64
from tools.journal import Journal, read_journal
from tools.kill_campaign.modules import PAUSE_FILE, QUIET

BEAT = "painter_beat"
LATCHED = ("painter", "painter_rare")
"""The publishers of latched topics; each topic has the name of its publisher."""
COMERS = ("comer", "comer_all", "comer_newest", "comer_pattern", "comer_after_setup")
VISITOR = "visitor"
"""The tool that attaches again and again; each time counts as a process of its own."""
_PUBLISHER = "tools.kill_campaign.latched:Painter"
_SUBSCRIBER = "tools.kill_campaign.latched:Comer"
PARTS: dict[str, dict[str, Any]] = {
    "comer": {"class": _SUBSCRIBER},
    "comer_all": {"class": _SUBSCRIBER, "settings": {"way": "all topics"}},
    "comer_newest": {"class": _SUBSCRIBER, "settings": {"way": "newest"}},
    "comer_pattern": {"class": _SUBSCRIBER, "settings": {"way": "pattern"}},
    "comer_after_setup": {"class": _SUBSCRIBER, "settings": {"way": "after setup"}},
    "painter": {"class": _PUBLISHER, "settings": {"period_s": 0.4, "largest_bytes": 256 << 10}},
    "painter_rare": {"class": _PUBLISHER, "settings": {"period_s": 10.0}},
    BEAT: {"class": _PUBLISHER, "settings": {"period_s": 0.05, "latched": False}},
}
ROWS_AT_REST = 2 * len(LATCHED)
"""Rows of the core's tables that stay in use: for each latched topic a message, and a reference to it."""
Key = tuple[int, int]
"""Incarnation and number of a message of one publisher."""


class Painting(Message, name="campaign_msgs/msg/Painting", version=1):
    """A numbered message."""

    incarnation: uint64  # counts the publisher's processes, from 1
    number: uint64  # counts what this incarnation tried to publish, from 0
    payload: Array[uint8]  # (N,)


class Painter(Module):
    """Publishes on the topic that has its name. When paused, it publishes once more, then rests.

    A restarted one waits for one period, so that its last message outlives the process that published it.
    """

    period_s: float = setting(1.0, "time between messages", minimum=0.001)
    largest_bytes: int = setting(64, "largest payload", minimum=1)
    latched: bool = setting(True, "whether the topic is latched")

    def setup(self) -> None:
        """Start a new incarnation and journal it."""
        self.life = (self.restored or 0) + 1
        self.checkpoint(self.life)
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.journal.note("S", self.life)
        self.number = 0
        self.waits = self.life > 1
        self.is_done = False

    def tick(self) -> None:
        """Publish the next number; after the last one, say whether all other messages are released."""
        is_paused = (self.output_directory / PAUSE_FILE).exists()
        if not self.waits and not (is_paused and self.is_done):
            self.is_done = self.paint() and is_paused
        self.waits = False
        kept = int(self.latched)
        is_quiet = self.is_done and self.outstanding == kept
        self.status = QUIET if is_quiet else f"{self.number} published, {self.outstanding} outstanding"

    def paint(self) -> bool:
        """Publish the next number, and journal it before and after; return whether it was accepted."""
        number, self.number = self.number, self.number + 1
        size = self.largest_bytes >> number % 4
        message = Painting(
            incarnation=self.life, number=number, payload=np.full(size, number % 256, np.uint8)
        )
        self.journal.note("I", number)
        accepted = self.publish(message, topic=self.name, latched=self.latched)
        self.journal.note("A" if accepted else "R", number)
        return accepted


class Comer(Module):
    """Subscribes to all topics of the painters, and journals what it handles."""

    way: str = setting(
        "each topic", "how it subscribes: each topic, all topics, newest, pattern, after setup"
    )
    period_s = 0.1

    def setup(self) -> None:
        """Journal a new incarnation, and subscribe."""
        self.life = (self.restored or 0) + 1
        self.checkpoint(self.life)
        self.journal = Journal(self.output_directory / f"{self.name}.journal")
        self.journal.note("S", self.life)
        self.has_subscribed = self.way != "after setup"
        if self.has_subscribed:
            self.listen()

    def listen(self) -> None:
        """Subscribe; to the beat last, as a subscription after the setup takes effect at once."""
        if self.way == "pattern":
            self.subscribe_encoded(Painting.type_name, self.on_encoded)
        elif self.way == "all topics":
            self.subscribe(Painting, self.on_painting)
        else:
            newest = self.way == "newest"
            handling = MessageHandling.KEEP_ONLY_NEWEST if newest else MessageHandling.ALWAYS_DELIVER
            for topic in (*LATCHED, BEAT):
                self.subscribe(Painting, self.on_painting, handling, topic=topic)

    def tick(self) -> None:
        """Subscribe after the setup, if that is its way; say whether it is paused."""
        if not self.has_subscribed:
            self.has_subscribed = True
            self.listen()
        is_paused = (self.output_directory / PAUSE_FILE).exists()
        self.status = QUIET if is_paused else f"incarnation {self.life}"

    def on_encoded(self, message: EncodedMessage) -> None:
        """Journal a message that came by a pattern."""
        self.on_painting(Painting.decode(message.data))

    def on_painting(self, painting: Painting) -> None:
        """Journal a message; one that is damaged, as one that was never published."""
        note_painting(self.journal, self.envelope.sequence, self.envelope.topic, painting)


def note_painting(journal: Journal, sequence: int, topic: str, painting: Painting) -> None:
    """Journal a message that arrived; one that is damaged, as one that was never published."""
    is_whole = bool(np.all(painting.payload == painting.number % 256))
    journal.note("E", sequence, topic, painting.incarnation, painting.number if is_whole else -1)


@dataclass
class _Painted:
    """The journal of a publisher."""

    intended_ns: dict[Key, int] = field(default_factory=dict)
    refused: set[Key] = field(default_factory=set)
    last_accepted: Key = (0, -1)

    def has_between(self, key: Key, at_ns: int) -> bool:
        """Whether a message after this one may have been published before a moment."""
        return any(
            other > key and intended_ns < at_ns and other not in self.refused
            for other, intended_ns in reversed(self.intended_ns.items())
        )


@dataclass(frozen=True)
class _Entry:
    """A handler that was entered."""

    sequence: int
    topic: str
    key: Key
    at_ns: int


@dataclass
class _Life:
    """The messages that one incarnation of a subscriber handled."""

    name: str
    incarnation: int
    began_ns: int
    entries: list[_Entry] = field(default_factory=list)


def judge_latched(folder: Path) -> tuple[dict[str, int], list[str]]:
    """Judge the journals of a robot at rest.

    Returns:
        What happened, and the violations. A latched message must be the newest that was routed before its
        subscriber started, or a newer one; no process may get a message twice; and a process may get a
        message again that an earlier one had only if it is the first of its topic.
    """
    painted = {name: _read_painted(folder / f"{name}.journal") for name in (*LATCHED, BEAT)}
    lives = {name: _read_lives(name, folder / f"{name}.journal") for name in (*COMERS, VISITOR)}
    known = _known(lives)
    counts: Counter[str] = Counter()
    violations: list[str] = []
    for name, of_module in lives.items():
        violations += _judge_order(name, of_module, painted, counts)
        for life in of_module:
            for topic in LATCHED:
                violations += _judge_late(life, topic, known[topic], painted[topic], counts)
        for topic in LATCHED:
            last = painted[topic].last_accepted
            entries = of_module[-1].entries if of_module else []
            has = max((entry.key for entry in entries if entry.topic == topic), default=(0, -1))
            if has < last:
                violations.append(f"{name} {len(of_module)}: at rest it has {topic} {has}, not {last}")
    counts["visits of a tool"] = len(lives[VISITOR])
    counts["latched messages"] = sum(len(painted[topic].intended_ns) for topic in LATCHED)
    return dict(counts), violations


def _read_painted(path: Path) -> _Painted:
    found, incarnation = _Painted(), 0
    for kind, number, at_ns in read_journal(path):
        if kind == "S":
            incarnation = int(number)
            continue
        key = (incarnation, int(number))
        if kind == "I":
            found.intended_ns[key] = int(at_ns)
        elif kind == "A":
            found.last_accepted = key
        else:
            found.refused.add(key)
    return found


def _read_lives(name: str, path: Path) -> list[_Life]:
    lives: list[_Life] = []
    for kind, *words in read_journal(path):
        if kind == "S":
            lives.append(_Life(name, int(words[0]), int(words[1])))
        else:
            sequence, topic, incarnation, number, at_ns = words
            key = int(incarnation), int(number)
            lives[-1].entries.append(_Entry(int(sequence), topic, key, int(at_ns)))
    return lives


def _known(lives: Mapping[str, list[_Life]]) -> dict[str, list[_Entry]]:
    """Return the messages of each latched topic in their order, each when a handler first had it."""
    first: dict[str, dict[int, _Entry]] = {topic: {} for topic in LATCHED}
    for of_module in lives.values():
        for life in of_module:
            for entry in life.entries:
                if entry.topic in first:
                    before = first[entry.topic].setdefault(entry.sequence, entry)
                    if entry.at_ns < before.at_ns:
                        first[entry.topic][entry.sequence] = entry
    return {topic: [found[sequence] for sequence in sorted(found)] for topic, found in first.items()}


def _judge_order(
    name: str, lives: list[_Life], painted: Mapping[str, _Painted], counts: Counter[str]
) -> Iterator[str]:
    """Check that no process gets a message twice, or one that was never published, or one out of order."""
    before: dict[str, int] = {}  # the last sequence of each topic in earlier lives
    for life in lives:
        last: dict[str, int] = {}
        for entry in life.entries:
            what = f"{name} {life.incarnation}: message {entry.sequence} of {entry.topic}"
            if entry.key not in painted[entry.topic].intended_ns or entry.key in painted[entry.topic].refused:
                yield f"{what} {entry.key} is damaged or was never published"
            if entry.sequence <= last.get(entry.topic, 0):
                yield f"{what} came twice or out of order"
            if entry.sequence <= before.get(entry.topic, 0):
                counts["given again"] += 1
                if entry.topic not in LATCHED:
                    yield f"{what} is not latched, and came to an earlier process, too"
                elif entry.topic in last:
                    yield f"{what} came to an earlier process, too, and is not the first of its topic"
                elif entry.sequence < before[entry.topic]:
                    yield f"{what} is older than what an earlier process had"
            last[entry.topic] = entry.sequence
        for topic, sequence in last.items():
            before[topic] = max(sequence, before.get(topic, 0))


def _judge_late(
    life: _Life, topic: str, known: list[_Entry], painted: _Painted, counts: Counter[str]
) -> Iterator[str]:
    """Check that a process gets the newest message that was routed before it started, or a newer one."""
    newest = next((entry for entry in reversed(known) if entry.at_ns < life.began_ns), None)
    if newest is None:
        return
    counts["late joins"] += 1
    for entry in life.entries:
        if entry.topic == topic and entry.sequence >= newest.sequence:
            counts["had the newest or a newer one"] += 1
            return
        if entry.topic != BEAT or entry.sequence < newest.sequence:
            continue
        if life.name == "comer_newest" and painted.has_between(newest.key, entry.at_ns):
            continue  # a newer one may have taken its place, and come after the beat
        yield (
            f"{life.name} {life.incarnation}: beat {entry.sequence} came before {topic} {newest.sequence}, "
            "which was the newest when it started, or a newer one"
        )
        return
    counts["died before it could have it"] += 1
