"""Look-ups in a scene graph, and its errors."""

import math

import pytest
from numpy.testing import assert_allclose

from robbie_mp import RobbieError
from robbie_mp.scene import (
    BadJoint,
    Disconnected,
    DuplicateNode,
    Joint,
    JointType,
    Mimic,
    MissingParent,
    NeverPlaced,
    Node,
    NodeCycle,
    NotAPose,
    NotMovable,
    RigidTransform,
    SceneGraph,
    TooNew,
    TooOld,
    UnknownNode,
)
from robbie_mp.scene.rigid_transform import Pose7, compose

FLOATING = Joint(JointType.FLOATING)
SECOND = 10**9


def at_x(x: float) -> RigidTransform:
    return RigidTransform.of((x, 0.0, 0.0))


def robot(prefix: str = "", parent: str = "world") -> list[Node]:
    return [
        Node(f"{prefix}odom", parent, joint=FLOATING),
        Node(f"{prefix}base", f"{prefix}odom", joint=FLOATING),
        Node(f"{prefix}pan", f"{prefix}base", at_x(0.2), Joint(JointType.CONTINUOUS, f"{prefix}pan_joint")),
        Node(f"{prefix}camera", f"{prefix}pan", at_x(0.1)),
    ]


@pytest.fixture
def graph() -> SceneGraph:
    made = SceneGraph([Node("world"), *robot(), Node("island")])
    made.move("odom", 0, at_x(10.0))
    made.move("odom", 9 * SECOND, at_x(10.0))
    for second in range(3):
        made.move("base", second * SECOND, at_x(second))
        made.set_joint("pan_joint", second * SECOND, second * math.pi / 2)
    return made


def test_poses_between_two_messages_are_interpolated(graph: SceneGraph) -> None:
    camera = graph.pose("odom", "camera", SECOND // 2)
    assert camera.translation == pytest.approx(
        [0.7 + 0.1 * math.cos(math.pi / 4), 0.1 * math.sin(math.pi / 4), 0]
    )
    assert camera.yaw == pytest.approx(math.pi / 4)


def test_pose_and_its_inverse_cancel(graph: SceneGraph) -> None:
    there, back = graph.pose("world", "camera", 1), graph.pose("camera", "world", 1)
    assert_allclose((there @ back).matrix, RigidTransform().matrix, atol=1e-12)


def test_lookup_without_a_time_uses_the_newest_common_time(graph: SceneGraph) -> None:
    graph.move("base", 7 * SECOND, at_x(7.0))  # the pan joint is known until 2 s
    assert graph.newest_common_ns("world", "camera") == 2 * SECOND
    assert graph.pose("world", "base").x == 17.0
    assert graph.pose("odom", "camera").x == pytest.approx(2.1)
    assert graph.pose("pan", "camera") == at_x(0.1)
    assert graph.pose("world", "odom") == at_x(10.0)


def test_too_new_and_too_old_errors_say_by_how_much(graph: SceneGraph) -> None:
    with pytest.raises(TooNew, match=r"node 'base' is known until 2\.000000 s; asked for 0\.500000 s") as new:
        graph.pose("odom", "base", 2 * SECOND + SECOND // 2)
    assert new.value.by_s == 0.5
    with pytest.raises(TooOld, match=r"'base' is known from 0\.000000 s on; asked for 1\.000000 s") as old:
        graph.pose("odom", "base", -SECOND)
    assert old.value.by_s == 1.0
    assert isinstance(new.value, RobbieError) and isinstance(old.value, ValueError)


def test_unknown_names_are_reported_with_similar_ones(graph: SceneGraph) -> None:
    with pytest.raises(UnknownNode, match="no node 'camra'; did you mean 'camera'"):
        graph.pose("world", "camra")
    with pytest.raises(UnknownNode, match="no joint 'pan_join'; did you mean 'pan_joint'"):
        graph.set_joint("pan_join", 0, 1.0)
    with pytest.raises(LookupError):
        graph.move("bse", 0, at_x(0.0))


def test_two_trees_are_not_connected(graph: SceneGraph) -> None:
    with pytest.raises(
        Disconnected, match=r"'camera' and 'island' .* below 'world', the other below 'island'"
    ):
        graph.pose("camera", "island")


def test_lookup_of_a_node_that_was_never_placed_is_an_error() -> None:
    graph = SceneGraph([Node("world"), *robot()])
    for time_ns in (None, 5):
        with pytest.raises(NeverPlaced, match="node 'odom' is not known yet"):
            graph.pose("world", "odom", time_ns)


def test_only_nodes_with_joints_can_be_moved(graph: SceneGraph) -> None:
    with pytest.raises(NotMovable, match="'camera' is fixed, not floating"):
        graph.move("camera", 0, at_x(0.0))
    with pytest.raises(NotMovable, match="'pan' is continuous"):
        graph.move("pan", 0, at_x(0.0))
    with pytest.raises(NotAPose, match="'pan_joint': a position must be a finite number, not nan"):
        graph.set_joint("pan_joint", 0, math.nan)


def test_continuous_joint_turns_the_shorter_way(graph: SceneGraph) -> None:
    graph.set_joint("pan_joint", 3 * SECOND, math.radians(170))
    graph.set_joint("pan_joint", 4 * SECOND, math.radians(-170))
    yaw = graph.pose("base", "pan", 3 * SECOND + SECOND // 2).yaw
    assert abs(yaw) == pytest.approx(math.pi)


def test_late_messages_are_sorted_in_and_repeated_times_replace(graph: SceneGraph) -> None:
    graph.move("base", SECOND // 2, at_x(5.0))
    assert graph.pose("odom", "base", SECOND // 4).x == 2.5
    graph.move("base", SECOND // 2, at_x(6.0))
    assert graph.pose("odom", "base", SECOND // 2).x == 6.0
    assert graph.newest_ns("base") == 2 * SECOND


def test_history_is_bounded_by_time_and_number() -> None:
    graph = SceneGraph(
        [Node("world"), Node("base", "world", joint=FLOATING)], history_s=1.0, history_limit=50
    )
    for milliseconds in range(0, 5000, 100):
        graph.move("base", milliseconds * 10**6, at_x(milliseconds))
    assert graph.pose("world", "base", 4 * SECOND).x == 4000
    with pytest.raises(TooOld):
        graph.pose("world", "base", 3 * SECOND)
    with pytest.raises(TooOld, match=r"2\.900 s more than the 1 s that are remembered"):
        graph.move("base", SECOND, at_x(0.0))
    for nanoseconds in range(1000):
        graph.move("base", 5 * SECOND + nanoseconds, at_x(0.0))
    with pytest.raises(TooOld):
        graph.pose("world", "base", 5 * SECOND + 900)
    graph.forget()
    graph.move("base", SECOND, at_x(1.0))
    assert graph.pose("world", "base").x == 1.0


def test_one_future_stamp_does_not_block_a_node_for_ever() -> None:
    graph = SceneGraph([Node("world"), Node("base", "world", joint=FLOATING)])
    graph.move("base", 3600 * SECOND, at_x(0.0))
    for second in range(9):
        with pytest.raises(TooOld):
            graph.move("base", second * SECOND, at_x(second))
    graph.move("base", 9 * SECOND, at_x(9.0))
    graph.move("base", 10 * SECOND, at_x(10.0))
    assert graph.pose("world", "base").x == 10.0


def test_slash_before_a_name_makes_no_second_frame() -> None:
    floating = Joint(JointType.FLOATING)
    graph = SceneGraph([Node("/map"), Node("base", "map", joint=floating), Node("laser", "/base")])
    graph.move("/base", 0, RigidTransform(x=1.0))
    assert [node.name for node in graph] == ["map", "base", "laser"]
    assert graph.pose("map", "/laser") == graph.pose("/map", "laser") == RigidTransform(x=1.0)
    assert "/base" in graph and 5 not in graph
    with pytest.raises(DuplicateNode):
        SceneGraph([Node("map"), Node("/map")])


def turned(name: str, mimic: Mimic | None = None) -> Node:
    return Node(name, "a", joint=Joint(JointType.REVOLUTE, name, mimic=mimic))


def followed(name: str, leader: str, multiplier: float = 1.0, offset: float = 0.0) -> Node:
    return turned(name, Mimic(leader, multiplier, offset))


def test_chain_of_mimic_joints_follows_its_first_joint() -> None:
    last, middle = followed("last", "middle", 0.5, 0.2), followed("middle", "first", 0.8, -0.1)
    graph = SceneGraph([Node("a"), last, middle, turned("first")])
    graph.add(followed("added", "last", -1.0))
    graph.set_joint("first", 0, 1.0)
    yaws = {name: graph.pose("a", name, 0).yaw for name in ("middle", "last", "added")}
    assert yaws == pytest.approx({"middle": 0.7, "last": 0.55, "added": -0.55})


def test_mimic_joint_follows_another_joint() -> None:
    finger = Joint(JointType.PRISMATIC, "left", axis=(0.0, 2.0, 0.0))
    mirrored = Joint(JointType.PRISMATIC, "right", axis=(0.0, 1.0, 0.0), mimic=Mimic("left", -1.0, 0.01))
    graph = SceneGraph(
        [
            Node("hand"),
            Node("right_finger", "hand", joint=mirrored),
            Node("left_finger", "hand", joint=finger),
        ]
    )
    graph.set_joint("left", 0, 0.03)
    assert graph.pose("hand", "left_finger", 0).y == 0.03
    assert graph.pose("hand", "right_finger", 0).y == pytest.approx(-0.02)
    assert graph.joints == ("left",)


def test_several_robots_in_one_world() -> None:
    graph = SceneGraph([Node("world"), *robot("red/"), *robot("blue/")])
    for prefix, x in (("red/", 1.0), ("blue/", 5.0)):
        graph.move(f"{prefix}odom", 0, at_x(x))
        graph.move(f"{prefix}base", 0, at_x(0.0))
    assert graph.pose("red/base", "blue/base", 0).x == 4.0


def test_node_is_moved_to_another_parent_with_its_subtree(graph: SceneGraph) -> None:
    graph.hang(Node("island", "camera", at_x(1.0)))
    assert graph.pose("pan", "island").x == pytest.approx(1.1)
    graph.hang(Node("island", "odom", joint=FLOATING))
    with pytest.raises(NeverPlaced):
        graph.pose("odom", "island")
    assert graph.pose("world", "base", SECOND).x == 11.0
    with pytest.raises(NotMovable, match="'pan' cannot get another parent: it moves by a joint"):
        graph.hang(Node("pan", "world"))
    with pytest.raises(NodeCycle):
        graph.hang(Node("world", "camera"))


def test_fixed_nodes_add_no_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    row = [Node("n0"), *(Node(f"n{number}", f"n{number - 1}", at_x(1.0)) for number in range(1, 100))]
    row[50] = Node("n50", "n49", at_x(1.0), Joint(JointType.PRISMATIC, "j", (1.0, 0.0, 0.0)))
    graph = SceneGraph(row)
    graph.set_joint("j", 0, 0.5)
    composed: list[None] = []

    def counted(first: Pose7, second: Pose7) -> Pose7:
        composed.append(None)
        return compose(first, second)

    monkeypatch.setattr("robbie_mp.scene.graph.compose", counted)
    assert graph.pose("n0", "n99", 0).x == 99.5
    assert graph.pose("n49", "n1", 0).x == -48.0
    assert len(composed) == 1


def test_nodes_can_be_added_to_a_graph_in_use(graph: SceneGraph) -> None:
    graph.add(Node("lens", "camera", at_x(0.01)))
    assert graph.pose("pan", "lens").x == pytest.approx(0.11)
    with pytest.raises(DuplicateNode, match="node 'lens' exists already"):
        graph.add(Node("lens", "world"))
    with pytest.raises(MissingParent, match="'camara', does not exist; did you mean 'camera'"):
        graph.add(Node("glass", "camara"))
    with pytest.raises(DuplicateNode, match="joint 'pan_joint' exists already"):
        graph.add(Node("glass", "camera", joint=Joint(JointType.REVOLUTE, "pan_joint")))


@pytest.mark.parametrize(
    ("nodes", "error", "text"),
    [
        ([Node("a"), Node("a")], DuplicateNode, "node 'a' is described twice"),
        (
            [Node("a"), Node("b", "aa")],
            MissingParent,
            "the parent of node 'b', 'aa', does not exist; did you mean 'a'",
        ),
        ([Node("a", "c"), Node("b", "a"), Node("c", "b")], NodeCycle, "'?a on c on b on a'?"),
        ([Node("a", "a")], NodeCycle, "a on a"),
        (
            [Node("a"), *(Node(name, "a", joint=Joint(JointType.REVOLUTE, "j")) for name in "bc")],
            DuplicateNode,
            "joint 'j' is described twice, also at node 'b'",
        ),
        (
            [Node("a"), Node("b", "a", joint=Joint(JointType.REVOLUTE, "j", mimic=Mimic("i")))],
            MissingParent,
            "joint 'j' follows 'i', which does not exist",
        ),
        (
            [Node("a"), Node("b", "a", joint=Joint(JointType.REVOLUTE, "j", mimic=Mimic("j")))],
            NodeCycle,
            "joints follow one another: 'j' follows 'j'",
        ),
        (
            [Node("a"), *(followed(name, leader) for name, leader in ("bc", "cd", "db"))],
            NodeCycle,
            "joints follow one another: 'b' follows 'c' follows 'd' follows 'b'",
        ),
        (
            [
                Node("a"),
                turned("b"),
                followed("c", "b", 1e200),
                followed("d", "c", 1e200),
            ],
            BadJoint,
            "a joint follows 'b' with multiplier inf and offset 0; they must be finite",
        ),
    ],
)
def test_nodes_that_do_not_form_a_tree_are_refused(
    nodes: list[Node], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        SceneGraph(nodes)


def test_invalid_poses_are_refused() -> None:
    with pytest.raises(
        NotAPose, match=r"unit quaternion .* got \(0\.0, 0\.0, 0\.0, 2\.0\), whose length is 2"
    ):
        RigidTransform.of((0, 0, 0), (0, 0, 0, 2))
    with pytest.raises(NotAPose, match="the field was never set"):
        RigidTransform.of((0, 0, 0), (0, 0, 0, 0))
    with pytest.raises(NotAPose, match="finite numbers as translation"):
        RigidTransform.of((0, math.inf, 0))
    with pytest.raises(NotAPose, match="length is nan"):
        RigidTransform.of((0, 0, 0), (0, 0, 0, math.nan))
    assert math.hypot(*RigidTransform.of((0, 0, 0), (0, 0, 0.7071, 0.7071)).quaternion) == 1.0


def test_invalid_joints_are_refused() -> None:
    with pytest.raises(BadJoint, match="must have a direction"):
        Joint(JointType.REVOLUTE, "j", axis=(0.0, 0.0, 0.0))
    with pytest.raises(BadJoint, match=r"must be \[lower, upper\]"):
        Joint(JointType.REVOLUTE, "j", limits=(1.0, -1.0))
    with pytest.raises(BadJoint, match="needs a name"):
        Joint(JointType.REVOLUTE)
    with pytest.raises(BadJoint, match="messages set its pose"):
        Node("a", "b", at_x(1.0), FLOATING)
    with pytest.raises(BadJoint, match="no parent"):
        Node("a", None, at_x(1.0))
