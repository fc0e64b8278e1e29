"""The verdict on a campaign: compares the journals with the core's counters.

If a publisher is killed between the line before `publish` and the line after it, it is unknown whether this
one number was published, unless a subscriber has it. So each death of a publisher makes the number of its
published messages uncertain by at most one. Nothing else is uncertain.

For a subscription with E messages entered and L left in the journal, D deaths of its module, and the
core's figures, all of this must hold:

- accepted ≤ routed ≤ accepted + uncertain, where uncertain messages that a subscriber has count as accepted;
- routed is the number of messages that passed through its channels, the same for all of its kind;
- routed = delivered + replaced + dropped + lost, nothing waiting;
- delivered ≤ L, E - L ≤ lost, E ≤ delivered + lost. Together with the line above: every message that is
  not in the journal is in replaced, dropped or lost;
- lost ≤ D, over all subscriptions of the module;
- the last message of each publisher has arrived: a full queue drops its oldest message, and a subscriber
  that keeps only the newest has the newest at the end.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from robbie_mp import MessageHandling
from robbie_mp.bus.observe import ChannelFigures, ModuleFigures, SubscriptionFigures
from robbie_mp.bus.transport.tables import COLUMNS
from tools.kill_campaign.message import Numbered
from tools.kill_campaign.records import Handled, ModuleRecord, read_handled, read_published

MORE = "{} more violations like these"
SHOWN = 50


@dataclass
class CampaignVerdict:
    """The findings of a campaign.

    Attributes:
        records: the journal of each module.
        violations: broken promises, one line each.
    """

    records: dict[str, ModuleRecord]
    violations: list[str] = field(default_factory=list)

    def totals(self) -> dict[str, int]:
        """Return the number of messages by outcome, from the journals."""
        published = [record.published for record in self.records.values()]
        handled = [entry for record in self.records.values() for entry in record.handled.values()]
        return {
            "accepted": sum(entry.accepted for entry in published),
            "refused": sum(len(entry.refused) for entry in published),
            "uncertain": sum(len(entry.uncertain) for entry in published),
            "handlers_entered": sum(entry.entered for entry in handled),
            "handlers_left": sum(entry.left for entry in handled),
        }


def read_records(folder: Path, names: list[str]) -> dict[str, ModuleRecord]:
    """Read the journals of all modules: first all publishers, then what arrived."""
    records = {name: ModuleRecord() for name in names}
    for name, record in records.items():
        read_published(folder / f"{name}.journal", record)
    publishers = {name: record.published for name, record in records.items()}
    for name, record in records.items():
        read_handled(folder / f"{name}.journal", record, publishers)
    return records


def judge(
    records: dict[str, ModuleRecord], modules: Mapping[str, ModuleFigures], channels: list[ChannelFigures]
) -> CampaignVerdict:
    """Compare journals with counters of a robot at rest.

    Args:
        records: the journal of each module.
        modules: figures of the modules by name.
        channels: figures of all channels.
    """
    verdict = CampaignVerdict(records)
    for record in records.values():
        verdict.violations += record.violations[:SHOWN]
        if len(record.violations) > SHOWN:
            verdict.violations.append(MORE.format(len(record.violations) - SHOWN))
    messages = {
        channel.topic: channel.messages for channel in channels if channel.type_name == Numbered.type_name
    }
    seen: dict[str, set[tuple[int, int]]] = {name: set() for name in records}
    for record in records.values():
        for sender, handled in record.handled.items():
            seen[sender] |= handled.uncertain
    for name, record in records.items():
        verdict.violations += _publisher(modules[name], record, messages.get(name, 0), len(seen[name]))
        verdict.violations += _subscriber(modules[name], record, messages)
        verdict.violations += _last_messages(modules[name], record, records)
    return verdict


def _publisher(module: ModuleFigures, record: ModuleRecord, messages: int, seen: int) -> Iterator[str]:
    published = record.published
    doubt = len(published.uncertain) - seen
    for what, least, counted in (
        ("passed through its channel", published.accepted + seen, messages),
        ("were refused", len(published.refused), module.refused),
    ):
        if not least <= counted <= least + doubt:
            yield f"{module.name}: {counted} {what}; the journal says {least}, at most {doubt} more"
    if not published.accepted <= module.published <= published.accepted + len(published.uncertain):
        yield f"{module.name}: published {module.published}; its journal says {published.accepted}"
    if len(published.uncertain) > module.restarts:
        yield f"{module.name}: {len(published.uncertain)} uncertain numbers, {module.restarts} deaths"


def _subscriber(module: ModuleFigures, record: ModuleRecord, messages: Mapping[str, int]) -> Iterator[str]:
    for books in module.subscriptions:
        topics = [books.topic] if books.topic else list(messages)
        routed = sum(messages.get(topic, 0) for topic in topics)
        entries = [record.handled[topic] for topic in topics if topic in record.handled]
        for problem in _subscription(books, entries, routed):
            yield f"{module.name} on '{books.topic}': {problem}"
    if module.total("lost") > module.restarts:
        yield f"{module.name}: {module.total('lost')} lost, but only {module.restarts} deaths"


def _last_messages(
    module: ModuleFigures, record: ModuleRecord, records: Mapping[str, ModuleRecord]
) -> Iterator[str]:
    """If a subscription to all publishers keeps the newest one, only the last of all must have arrived."""
    for books in module.subscriptions:
        if not books.topic and books.handling == MessageHandling.KEEP_ONLY_NEWEST.name:
            continue
        for topic in [books.topic] if books.topic else records:
            last = records[topic].published.last_accepted
            if last[0] and (topic not in record.handled or record.handled[topic].last_key < last):
                yield f"{module.name}: the last message of {topic}, {last}, has not arrived"


def _subscription(books: SubscriptionFigures, entries: list[Handled], routed: int) -> Iterator[str]:
    entered, left = (sum(getattr(entry, column) for entry in entries) for column in ("entered", "left"))
    if books.routed != routed:
        yield f"{books.routed} routed, but {routed} passed through the channel"
    if books.waiting:
        yield f"the books do not balance by {books.waiting}: {books}"
    if books.delivered > left:
        yield f"{books.delivered} delivered, but the journal has only {left} handlers left"
    if entered - left > books.lost:
        yield f"{entered - left} handlers entered and not left, but only {books.lost} lost"
    if entered > books.delivered + books.lost:
        yield f"{entered} handlers entered, but {books.delivered} delivered and {books.lost} lost"


def causes(modules: Mapping[str, ModuleFigures]) -> dict[str, int]:
    """Return the outcome of all routed messages, over all subscriptions."""
    found: Counter[str] = Counter()
    for module in modules.values():
        for column in COLUMNS:
            found[column] += module.total(column)
    return dict(found)
