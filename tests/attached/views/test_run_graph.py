"""Graphs of modules and topics, as text for Mermaid and Graphviz, and as SVG."""

import xml.etree.ElementTree as ET
from itertools import combinations

from robbie_mp.attached.views.run_graph import RunGraph, Topic, dot, mermaid
from robbie_mp.attached.views.run_graph_svg import svg

GRAPH = RunGraph(
    ("laser", 'odd "name" #1'),
    (
        Topic("sensor_msgs/msg/LaserScan", 1, "front", ("laser",), ('odd "name" #1',), (), 9.96),
        Topic("a/msg/B", 1, "", (), (), ("laser",), None),
    ),
)


def test_mermaid() -> None:
    assert mermaid(GRAPH).splitlines() == [
        "flowchart LR",
        '    m0["laser"]',
        '    m1["odd #quot;name#quot; #35;1"]',
        '    t0(["front<br/>sensor_msgs/msg/LaserScan<br/>9.96 Hz"])',
        "    m0 --> t0",
        "    t0 --> m1",
        '    t1(["a/msg/B"])',
        "    t1 -.-> m0",
    ]


def test_dot() -> None:
    assert dot(GRAPH).splitlines() == [
        "digraph run {",
        "    rankdir=LR;",
        "    node [shape=box];",
        '    m0 [label="laser"];',
        r'    m1 [label="odd \"name\" #1"];',
        r'    t0 [shape=ellipse, label="front\nsensor_msgs/msg/LaserScan\n9.96 Hz"];',
        "    m0 -> t0;",
        "    t0 -> m1;",
        '    t1 [shape=ellipse, label="a/msg/B"];',
        "    t1 -> m0 [style=dashed];",
        "}",
    ]


def test_svg_shows_each_name_and_each_connection() -> None:
    root = ET.fromstring(svg(GRAPH))
    spaces = "{http://www.w3.org/2000/svg}"
    texts = [element.text for element in root.iter(f"{spaces}text")]
    assert texts == [
        "laser", "front", "sensor_msgs/msg/LaserScan", "9.96 Hz", "a/msg/B", 'odd "name" #1', "laser",
    ]  # fmt: skip
    assert [path.get("class") for path in root.iter(f"{spaces}path")] == ["named", "named", "patterns"]


def test_boxes_of_an_svg_do_not_overlap() -> None:
    names = [f"module{number}" for number in range(12)]
    topics = [
        Topic("a/msg/B", 1, f"t{number}", (names[number % 5],), tuple(names[number % 7 : 9]), (), None)
        for number in range(30)
    ]
    root = ET.fromstring(svg(RunGraph(tuple(names), tuple(topics))))
    boxes = [
        [float(rect.get(key) or 0) for key in ("x", "y", "width", "height")]
        for rect in root.iter("{http://www.w3.org/2000/svg}rect")
    ]
    assert len(boxes) > 30 + 9
    for (x, y, width, height), (left, top, wide, high) in combinations(boxes, 2):
        assert x + width <= left or left + wide <= x or y + height <= top or top + high <= y
    assert all(x + width <= float(root.get("width") or 0) for x, _, width, _ in boxes)
    assert all(y + height <= float(root.get("height") or 0) for _, y, _, height in boxes)
