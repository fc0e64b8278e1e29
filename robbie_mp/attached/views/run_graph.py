"""The modules of a run and the topics between them, as a graph for Mermaid or Graphviz."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe import RunRates, RunReading
from robbie_mp.bus.observe.talk import talk_of
from robbie_mp.bus.transport.board import TOOL_PREFIX
from robbie_mp.bus.transport.records import ANY_VERSION
from robbie_mp.bus.transport.tables import ChannelName


@dataclass(frozen=True)
class Topic:
    """A type and topic that is published or subscribed to."""

    type_name: str
    version: int
    topic: str
    publishers: tuple[str, ...]
    subscribers: tuple[str, ...]
    pattern_subscribers: tuple[str, ...]
    """Those that subscribe by patterns, such as loggers."""
    hz: float | None
    """Messages per second; None if it was not measured."""

    @property
    def lines(self) -> list[str]:
        """Its text in a picture."""
        rate = [] if self.hz is None else [f"{self.hz:.3g} Hz"]
        return [one_line(line) for line in (self.topic, self.type_name, *rate) if line]


@dataclass(frozen=True)
class RunGraph:
    """The modules of a run and what they publish and subscribe to; without attached tools and the core."""

    modules: tuple[str, ...]
    topics: tuple[Topic, ...]


def graph_of(reading: RunReading, rates: RunRates | None = None, *, patterns: bool = True) -> RunGraph:
    """Return the graph of a run.

    Args:
        reading: the figures of the run.
        rates: the rates of the topics; None: none.
        patterns: whether to show subscriptions by patterns, which often take everything.
    """
    names = [module.name for module in reading.modules[:-1] if not module.name.startswith(TOOL_PREFIX)]
    topics: list[Topic] = []
    for talk in talk_of(reading):
        key = talk.channel.type_name, talk.channel.version, talk.channel.topic
        takers = [(module, entry) for module, entry in talk.subscribers if module in names]
        topics.append(
            Topic(
                *key,
                tuple(module for module in talk.publishers if module in names),
                _unique(module for module, entry in takers if entry.version != ANY_VERSION),
                _unique(module for module, entry in takers if entry.version == ANY_VERSION and patterns),
                rates.channels[key].hz if rates and key in rates.channels else None,
            )
        )
    published = [ChannelName(one.type_name, one.version, one.topic) for one in topics]
    topics += _unpublished(reading, names, published)
    shown = tuple(one for one in topics if one.publishers or one.subscribers or one.pattern_subscribers)
    busy = {name for one in shown for name in (*one.publishers, *one.subscribers, *one.pattern_subscribers)}
    supervisor = names[0]
    return RunGraph(tuple(name for name in names if name in busy or name != supervisor), shown)


def _unique(names: Iterator[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def _unpublished(
    reading: RunReading, names: Sequence[str], published: Sequence[ChannelName]
) -> Iterator[Topic]:
    """Yield what modules subscribe to, but nobody has published yet."""
    waiting: dict[ChannelName, list[str]] = {}
    for module in reading.modules:
        for entry in module.subscriptions if module.name in names else ():
            wanted = ChannelName(entry.type_name, entry.version, entry.topic)
            if entry.is_open and entry.version != ANY_VERSION and not any(map(wanted.takes, published)):
                waiting.setdefault(wanted, []).append(module.name)
    for wanted in sorted(waiting):
        yield Topic(*wanted, (), _unique(iter(waiting[wanted])), (), None)


def mermaid(graph: RunGraph) -> str:
    """Return the graph as a Mermaid flowchart."""
    lines = ["flowchart LR"]
    module_ids = {name: f"m{number}" for number, name in enumerate(graph.modules)}
    lines += [f'    {module_ids[name]}["{_for_mermaid(name)}"]' for name in graph.modules]
    for number, topic in enumerate(graph.topics):
        label = "<br/>".join(map(_for_mermaid, topic.lines))
        lines.append(f'    t{number}(["{label}"])')
        lines += [f"    {module_ids[name]} --> t{number}" for name in topic.publishers]
        lines += [f"    t{number} --> {module_ids[name]}" for name in topic.subscribers]
        lines += [f"    t{number} -.-> {module_ids[name]}" for name in topic.pattern_subscribers]
    return "\n".join(lines) + "\n"


def _for_mermaid(text: str) -> str:
    for character, entity in (("#", "#35;"), ('"', "#quot;"), ("<", "#lt;"), (">", "#gt;")):
        text = text.replace(character, entity)
    return text


def dot(graph: RunGraph) -> str:
    """Return the graph in the language of Graphviz."""
    lines = ["digraph run {", "    rankdir=LR;", "    node [shape=box];"]
    module_ids = {name: f"m{number}" for number, name in enumerate(graph.modules)}
    lines += [f'    {module_ids[name]} [label="{_for_dot(name)}"];' for name in graph.modules]
    for number, topic in enumerate(graph.topics):
        label = r"\n".join(map(_for_dot, topic.lines))
        lines.append(f'    t{number} [shape=ellipse, label="{label}"];')
        lines += [f"    {module_ids[name]} -> t{number};" for name in topic.publishers]
        lines += [f"    t{number} -> {module_ids[name]};" for name in topic.subscribers]
        takers = topic.pattern_subscribers
        lines += [f"    t{number} -> {module_ids[name]} [style=dashed];" for name in takers]
    return "\n".join([*lines, "}"]) + "\n"


def _for_dot(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"")
