"""Graphs of modules and topics, as text for Mermaid and Graphviz."""

from robbie_mp.attached.views.run_graph import RunGraph, Topic, dot, mermaid

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
