"""The graph of a run as an SVG: publishers on the left, topics in the middle, subscribers on the right.

This needs no other program. A module that publishes and subscribes is on both sides, so no line turns back.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

from robbie_mp.attached.views.run_graph import RunGraph
from robbie_mp.base.visible_text import one_line

LINE, CHARACTER = 16, 7.3
"""Height of a line of text, and width of a character, in pixels."""
PADDING, GAP, BETWEEN = 8, 10, 120
"""Inside a box, between boxes of a column, and between columns."""
STYLE = (
    "text { font: 12px monospace; } rect { fill: white; stroke: #333; } "
    ".topic { fill: #eef3fa; } path { fill: none; stroke: #777; } .patterns { stroke-dasharray: 5 4; }"
)


@dataclass
class GraphBox:
    """A rectangle with lines of text; `top` is set when the column is laid out."""

    lines: Sequence[str]
    kind: str
    top: float = 0.0

    @property
    def height(self) -> float:
        """Its height."""
        return len(self.lines) * LINE + 2 * PADDING

    @property
    def width(self) -> float:
        """The width that its text needs."""
        return max(map(len, self.lines)) * CHARACTER + 2 * PADDING

    @property
    def middle(self) -> float:
        """The height at which lines begin and end."""
        return self.top + self.height / 2


@dataclass
class GraphColumn:
    """Boxes of one width, below one another."""

    left: float
    boxes: Sequence[GraphBox]

    @property
    def right(self) -> float:
        """Where it ends."""
        return self.left + max((box.width for box in self.boxes), default=0.0)

    def drawn(self) -> Iterator[str]:
        """Yield each box as SVG."""
        for box in self.boxes:
            place = f'x="{self.left:.0f}" y="{box.top:.0f}"'
            size = f'width="{self.right - self.left:.0f}" height="{box.height:.0f}"'
            yield f'<rect {place} {size} rx="4" class="{box.kind}"/>'
            for number, line in enumerate(box.lines, start=1):
                y = box.top + PADDING + number * LINE - 4
                yield f'<text x="{self.left + PADDING:.0f}" y="{y:.0f}">{escape(line)}</text>'


def svg(graph: RunGraph) -> str:
    """Return the graph as the text of an SVG file."""
    topics = [GraphBox(topic.lines, "topic") for topic in graph.topics]
    _stack(topics)
    takers = [(*topic.subscribers, *topic.pattern_subscribers) for topic in graph.topics]
    givers = [topic.publishers for topic in graph.topics]
    others = [name for name in graph.modules if not any(name in names for names in (*givers, *takers))]
    publishers = _modules(topics, givers, others)
    subscribers = _modules(topics, takers, [])
    left = GraphColumn(GAP, list(publishers.values()))
    middle = GraphColumn(left.right + BETWEEN, topics)
    right = GraphColumn(middle.right + BETWEEN, list(subscribers.values()))
    curves = []
    for topic, box in zip(graph.topics, topics, strict=True):
        curves += [_curve(left.right, publishers[name], middle.left, box) for name in topic.publishers]
        for name in (*topic.subscribers, *topic.pattern_subscribers):
            kind = "named" if name in topic.subscribers else "patterns"
            curves.append(_curve(middle.right, box, right.left, subscribers[name], kind))
    drawn = [line for column in (left, middle, right) for line in column.drawn()]
    bottom = max((box.top + box.height for one in (left, middle, right) for box in one.boxes), default=0.0)
    size = f'width="{right.right + GAP:.0f}" height="{bottom + GAP:.0f}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}><style>{STYLE}</style>'
    return "\n".join([head, *curves, *drawn, "</svg>"]) + "\n"


def _modules(
    topics: Sequence[GraphBox], names_of: Sequence[Sequence[str]], others: Sequence[str]
) -> dict[str, GraphBox]:
    """Return the boxes of modules by name, each about as high as the topics with which it is connected."""
    heights: dict[str, list[float]] = {}
    for box, names in zip(topics, names_of, strict=True):
        for name in names:
            heights.setdefault(name, []).append(box.middle)
    means = {name: sum(middles) / len(middles) for name, middles in heights.items()}
    ordered = [*sorted(means, key=lambda name: means[name]), *others]
    boxes = {name: GraphBox([one_line(name)], "module", means.get(name, 0.0)) for name in ordered}
    _stack(list(boxes.values()))
    return boxes


def _stack(boxes: Sequence[GraphBox]) -> None:
    """Move boxes downwards until none covers another: `top` is where the middle of each should be."""
    free = float(GAP)
    for box in boxes:
        box.top = max(free, box.top - box.height / 2)
        free = box.top + box.height + GAP


def _curve(x: float, source: GraphBox, end: float, target: GraphBox, kind: str = "named") -> str:
    bend = (end - x) / 2
    ends = f"M{x:.0f},{source.middle:.1f} C{x + bend:.0f},{source.middle:.1f} "
    return (
        f'<path class="{kind}" d="{ends}{end - bend:.0f},{target.middle:.1f} {end:.0f},{target.middle:.1f}"/>'
    )
