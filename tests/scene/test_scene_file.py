"""Scene files in YAML, and the errors of invalid ones."""

import math
from pathlib import Path

import pytest

from robbie_mp import RobbieError
from robbie_mp.scene import (
    Joint,
    JointType,
    Mimic,
    Node,
    RigidTransform,
    SceneFileError,
    SceneGraph,
    read_scene,
)

ROBOT = """\
nodes:
  map:
  odom: {parent: map, joint: {type: floating}}
  base_link: {parent: odom, joint: {type: floating}}
  laser: {parent: base_link, translation: [0.2, 0, 0.3], rpy: [3.141592653589793, 0, 0]}
  camera:
    parent: base_link
    translation: [0.1, 0.0, 0.5]
    quaternion: [0, 0, 0.70710678, 0.70710678]
    joint: {type: revolute, name: pan, axis: [0, 0, 2], limits: [-1.5, 1.5]}
  lid: {parent: camera, joint: {type: prismatic, name: lid, mimic: {joint: pan, multiplier: 0.1}}}
"""


def write(folder: Path, text: str, name: str = "scene.yaml") -> Path:
    file = folder / name
    file.write_text(text)
    return file


def problems(file: Path) -> list[str]:
    """What is wrong with a file, without the folder."""
    with pytest.raises(SceneFileError) as caught:
        read_scene(file)
    assert isinstance(caught.value, RobbieError) and isinstance(caught.value, ValueError)
    return str(caught.value).replace(f"{file.parent}/", "").splitlines()


def test_scene_file_describes_nodes(tmp_path: Path) -> None:
    nodes = {node.name: node for node in read_scene(write(tmp_path, ROBOT))}
    assert list(nodes) == ["map", "odom", "base_link", "laser", "camera", "lid"]
    assert nodes["odom"] == Node("odom", "map", joint=Joint(JointType.FLOATING))
    assert nodes["laser"].origin == RigidTransform.from_rpy((0.2, 0.0, 0.3), (math.pi, 0.0, 0.0))
    pan = nodes["camera"].joint
    assert pan == Joint(JointType.REVOLUTE, "pan", (0.0, 0.0, 1.0), (-1.5, 1.5))
    assert nodes["camera"].origin.yaw == pytest.approx(math.pi / 2)
    assert nodes["lid"].joint == Joint(JointType.PRISMATIC, "lid", mimic=Mimic("pan", 0.1))


def test_several_robots_share_one_world(tmp_path: Path) -> None:
    write(tmp_path, ROBOT, "robot.yaml")
    world = write(
        tmp_path,
        """
        nodes: {world: }
        include:
          - {file: robot.yaml, prefix: red/, parent: world, translation: [0, 1, 0]}
          - {file: robot.yaml, prefix: blue/, parent: world, joint: {type: floating}}
        """,
        "world.yaml",
    )
    graph = SceneGraph(read_scene(world))
    assert len(graph) == 13
    assert graph.node("red/map") == Node("red/map", "world", RigidTransform(y=1.0))
    assert graph.node("blue/map") == Node("blue/map", "world", joint=Joint(JointType.FLOATING))
    assert graph.node("blue/camera").parent == "blue/base_link"
    assert graph.joints == ("red/pan", "blue/pan")
    assert graph.pose("world", "red/map").y == 1.0


def of_b(fields: str) -> str:
    return f"nodes:\n  a:\n  b: {{parent: a, {fields}}}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nodes: {a: , a: }", "1: YAML: key 'a' is set twice, first at scene.yaml:1"),
        (
            "nodes:\n  a: {parent: c}\n  b: {parent: a}\n  c: {parent: b}",
            "2: nodes hang on one another: a on c on b on a",
        ),
        (
            "nodes:\n  base: \n  a: {parent: bas}",
            "3: the parent of node 'a', 'bas', does not exist; did you mean 'base'?",
        ),
        (
            "nodes:\n  a:\n  b:\n    parent: a\n    quaternion: [0, 0, 0, 2]",
            "5: expected a unit quaternion (x, y, z, w); got (0.0, 0.0, 0.0, 2.0), whose length is 2",
        ),
        ("nodes:\n  a: {parnt: b}", "2: nodes.a.parnt: unknown key; did you mean 'parent'?"),
        ("node: {a: }", "1: node: unknown key; did you mean 'nodes'?"),
        (
            of_b("translation: [1, 2]"),
            "3: nodes.b.translation: expected a list of 3 finite numbers; got [1, 2]",
        ),
        (of_b("rpy: [1, .inf, 2]"), "3: nodes.b.rpy: expected a list of 3 finite numbers; got [1, inf, 2]"),
        (
            of_b("rpy: [0, 0, 90]"),
            "3: nodes.b.rpy: expected rad, at most one turn; got [0.0, 0.0, 90.0]; are they degrees?",
        ),
        (
            of_b("rpy: [0, 0, 0], quaternion: [0, 0, 0, 1]"),
            "3: nodes.b.rpy: give rpy or quaternion, not both",
        ),
        (
            of_b("joint: {type: revolut}"),
            "3: nodes.b.joint.type: there is no joint type 'revolut'; did you mean 'revolute'?",
        ),
        (
            of_b("joint: {type: revolute}"),
            "3: every joint needs a name, except floating joints, which have none",
        ),
        (of_b("joint: {name: j}"), "3: nodes.b.joint.type: missing; expected a text"),
        (of_b("joint: 5"), "3: nodes.b.joint: expected a map with keys such as 'type'"),
        ("nodes:\n  a:\n  b: {parent: 3}", "3: nodes.b.parent: expected a text; got 3"),
        ("nodes: [a]", "1: nodes: expected a map of names to nodes"),
        ("include: {file: a}", "1: include: expected a list of maps"),
        ("include:\n  - {prefix: a/}", "2: include[0].file: missing; expected a text"),
        ("include:\n  - {file: scene.yaml}", "2: include[0].file: 'scene.yaml' includes itself"),
        ("", "1: the file describes no nodes"),
        ("nodes: [", "1: YAML: "),
    ],
)
def test_invalid_files_are_refused_with_the_line(tmp_path: Path, text: str, said: str) -> None:
    (problem,) = problems(write(tmp_path, text))
    told = problem.removeprefix("scene.yaml:")
    assert told == said or (said.endswith(" ") and told.startswith(said))


def test_all_problems_are_reported_at_once(tmp_path: Path) -> None:
    told = problems(write(tmp_path, "nodes:\n  a: {colour: red}\n  b: {parent: 1}\nrobots: 2\n"))
    assert [each.split(": ")[0] for each in told] == ["scene.yaml:4", "scene.yaml:2", "scene.yaml:3"]


def test_problems_in_included_files_have_file_and_line(tmp_path: Path) -> None:
    write(tmp_path, "nodes:\n  a:\n  laser: {parent: a}\n", "one.yaml")
    two = write(tmp_path, "nodes:\n  b:\n  laser: {parent: b}\ninclude:\n  - {file: one.yaml}\n", "two.yaml")
    assert problems(two) == ["one.yaml:3: node 'laser' is described twice, first at two.yaml:3"]
    three = write(tmp_path, "include:\n  - file: one.yaml\n    parent: nowhere\n", "three.yaml")
    assert problems(three) == ["three.yaml:2: the parent of node 'a', 'nowhere', does not exist"]
    four = write(tmp_path, "nodes: {a: , b: }", "four.yaml")
    five = write(tmp_path, f"nodes: {{w: }}\ninclude:\n  - {{file: {four.name}, parent: w}}", "five.yaml")
    assert "four.yaml has several roots ('a', 'b')" in problems(five)[0]
    six = write(tmp_path, "include:\n  - {file: gone.yaml}\n", "six.yaml")
    assert problems(six)[0].startswith("six.yaml:2: include[0].file: there is no file ")


def test_missing_file_is_a_scene_error(tmp_path: Path) -> None:
    assert problems(tmp_path / "gone.yaml") == ["gone.yaml:1: cannot be read: No such file or directory"]
    assert problems(tmp_path / "gone.urdf") == ["gone.urdf:1: cannot be read: No such file or directory"]
