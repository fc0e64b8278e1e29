"""URDFs as they are found in the wild: read as the specification says, and what is left out is named."""

import codecs
import os
import shutil
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from robbie_mp.base.balance import LeftOut
from robbie_mp.scene import JointType, SceneFileError, SceneGraph, SceneNotes, read_scene
from robbie_mp.scene.urdf import describe_urdf, urdf_text
from tests.scene._support.strategies import PATIENT
from tests.scene._support.urdf_oddities import OddRobot, odd_robots
from tests.scene.test_scene_file import problems, write

POSITIONS = st.lists(st.floats(-3.0, 3.0), min_size=8, max_size=8)
TWO = '<link name="a"/><link name="b"/>'
ENDS = '<parent link="a"/><child link="b"/>'


def robot(inside: str, attributes: str = "") -> str:
    return f'<robot name="r" {attributes}>{TWO}<joint name="j" {inside}</joint></robot>'


def read(tmp_path: Path, text: str) -> tuple[SceneGraph, SceneNotes]:
    notes = SceneNotes()
    return SceneGraph(read_scene(write(tmp_path, text, "robot.urdf"), notes)), notes


@given(made=odd_robots(), positions=POSITIONS)
@settings(PATIENT, max_examples=15)
def test_robots_move_as_the_specification_says(
    tmp_path: Path, made: OddRobot, positions: list[float]
) -> None:
    check_robot(tmp_path, made, positions)


@pytest.mark.slow
@given(made=odd_robots(), positions=POSITIONS)
@settings(PATIENT, max_examples=200)
def test_many_robots_move_as_the_specification_says(
    tmp_path: Path, made: OddRobot, positions: list[float]
) -> None:
    check_robot(tmp_path, made, positions)


def check_robot(tmp_path: Path, made: OddRobot, positions: list[float]) -> None:
    graph, notes = read(tmp_path, made.text)
    known = dict(enumerate(positions))
    for name in graph.joints:
        graph.set_joint(name, 0, known[int(name[1:])])
    for number in range(len(made.joints) + 1):
        ours = graph.pose("l0", f"l{number}", 0).matrix
        assert_allclose(ours, made.pose(number, known), rtol=0.0, atol=1e-9)
    assert notes.balance.used == len(graph)
    assert describe_urdf(tmp_path / "robot.urdf")["links"] == str(len(graph))


@pytest.mark.parametrize(
    ("limit", "limits", "max_speed", "said"),
    [
        (
            'lower="-1" upper="1" velocity="-1"',
            (-1.0, 1.0),
            None,
            "<limit velocity=…> must be greater than 0",
        ),
        ('lower="-1" upper="1" effort="-1" velocity="2"', (-1.0, 1.0), 2.0, "<limit effort=…> must be great"),
        ('lower="1" upper="-1"', None, None, "lower and upper that are no range"),
        ('lower="nan" upper="1"', None, None, "lower and upper that are no range"),
        ('lower="-inf" upper="inf" velocity="inf"', (-np.inf, np.inf), None, ""),
        ('effort="0" velocity="0"', (0.0, 0.0), None, "<limit velocity=…> must be greater than 0, not 0"),
    ],
)
def test_limit_that_is_none_is_unknown_and_named(
    tmp_path: Path, limit: str, limits: tuple[float, float] | None, max_speed: float | None, said: str
) -> None:
    graph, notes = read(tmp_path, robot(f'type="revolute">{ENDS}<limit {limit}/>'))
    joint = graph.joint("j")
    assert (joint.limits, joint.max_speed) == (limits, max_speed)
    assert [said in text for text in notes.warnings] == ([True] if said else [])


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        (f'type="planar">{ENDS}<axis xyz="0 0 1"/>', "a planar joint is read as a floating one"),
        (f'type="floating">{ENDS}<origin xyz="1 0 0"/>', "the <origin> of a floating joint"),
        (f'type="floating">{ENDS}<mimic joint="j"/>', "a floating joint cannot follow another joint"),
        (f'type="fixed">{ENDS}<mimic joint="j"/>', "a fixed joint cannot follow another joint"),
        (
            f'type="fixed">{ENDS}<limitt/>',
            "a joint has no <limitt> in URDF; did you mean",
        ),
        (f'type="fixed">{ENDS}<origin/><origin/>', "a second <origin> of a joint"),
        (
            f'type="fixed">{ENDS}<origin xyz="0 0 0" rpyy="0 0 1"/>',
            "<origin> has no attribute 'rpyy' in URDF",
        ),
        (f'type="fixed">{ENDS}<origin quat_xyzw="0 0 1 0"/>', "quat_xyzw without <robot version="),
        (f'type="fixed">{ENDS}<origin rpy="0 0 -90"/>', "<origin rpy=…> is in rad, and beyond one turn"),
    ],
)
def test_what_changes_the_robot_is_a_warning(tmp_path: Path, inside: str, said: str) -> None:
    graph, notes = read(tmp_path, robot(inside))
    assert len(notes.warnings) == 1 and notes.warnings[0].partition(": ")[2].startswith(said)
    assert sum(notes.balance.left_out.values()) == 1
    assert graph.node("b").joint_type in (JointType.FIXED, JointType.FLOATING)
    with pytest.raises(LeftOut):
        read_scene(tmp_path / "robot.urdf", SceneNotes(is_strict=True))


def test_links_without_a_joint_are_trees_of_their_own_and_named(tmp_path: Path) -> None:
    graph, notes = read(tmp_path, "<robot name='r'><link name='a'/><link name='b'/><link name='c'/></robot>")
    assert [node.parent for node in graph] == [None] * 3
    assert "tree of its own (and 1 more)" in notes.warnings[0]


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        ('type="fixed">', "joint 'k' follows 'j', which is fixed: it has no position"),
        (
            'type="revolute"><limit lower="0" upper="1"/><mimic joint="k"/>',
            "joints follow one another: 'j' follows",
        ),
        (
            'type="revolute"><limit lower="0" upper="1"/><mimic joint="kk"/>',
            "joint 'j' follows 'kk', which does not",
        ),
    ],
)
def test_mimic_without_a_leader_is_refused(tmp_path: Path, joint: str, said: str) -> None:
    text = robot(joint.replace(">", f">{ENDS}", 1)).replace(
        "</robot>",
        '<link name="c"/><joint name="k" type="continuous"><parent link="b"/><child link="c"/>'
        '<mimic joint="j"/></joint></robot>',
    )
    told = problems(write(tmp_path, text, "robot.urdf"))
    assert any(said in line for line in told), told


def test_quaternion_beside_rpy_is_refused(tmp_path: Path) -> None:
    text = robot(f'type="fixed">{ENDS}<origin rpy="0 0 0" quat_xyzw="0 0 0 1"/>', 'version="1.1"')
    assert "<origin> has rpy and quat_xyzw" in problems(write(tmp_path, text, "robot.urdf"))[0]


@pytest.mark.parametrize("name", ["robot.urdf", "ROBOT.URDF", "robot.Urdf", "robot.xml", "robot"])
@pytest.mark.parametrize(
    ("mark", "encoding"),
    [
        (b"", "utf-8"),
        (codecs.BOM_UTF8, "utf-8"),
        (codecs.BOM_UTF16_LE, "utf-16-le"),
        (b"", "latin-1"),
        (b"", "gbk"),
        (b"", "cp1252"),
    ],
)
def test_urdf_is_known_by_its_content(tmp_path: Path, name: str, mark: bytes, encoding: str) -> None:
    declared = "utf-16" if mark == codecs.BOM_UTF16_LE else encoding
    letter = "手" if encoding == "gbk" else "é"
    text = f'<?xml version="1.0" encoding="{declared}"?>\n<robot><link name="{letter}"/></robot>'
    file = tmp_path / name
    file.write_bytes(mark + text.encode(encoding))
    assert [node.name for node in read_scene(file)] == [letter]
    assert f'name="{letter}"' in urdf_text(file)


def test_empty_and_foreign_files_with_the_suffix_of_a_urdf_are_refused(tmp_path: Path) -> None:
    assert problems(write(tmp_path, "", "robot.urdf")) == ["robot.urdf:1: not XML: no element found"]
    assert "not XML" in problems(write(tmp_path, "solid cube", "robot.URDF"))[0]
    assert "the robot has no <link>" in problems(write(tmp_path, "<robot/>", "robot.xml"))[0]


def test_huge_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robbie_mp.scene.xml_elements.MAX_ELEMENTS", 100)
    assert "more than 100 elements" in problems(write(tmp_path, "<robot>" + "<a/>" * 200, "r.urdf"))[0]
    file = tmp_path / "huge.urdf"
    with file.open("wb") as opened:
        opened.truncate(40 << 20)
    assert problems(file) == ["huge.urdf:1: larger than 32 MiB"]


def test_description_names_meshes_and_what_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "here.stl").write_bytes(b"")
    meshes = ("here.stl", "gone.stl", "package://robot/a.dae", "http://there/b.dae")
    shapes = "".join(f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>' for mesh in meshes)
    text = robot(f'type="revolute">{ENDS}<limit lower="0" upper="1" velocity="-1"/>', 'version="1.2"')
    file = write(tmp_path, text.replace('<link name="a"/>', f'<link name="a">{shapes}</link>'), "robot.urdf")
    told = describe_urdf(file)
    assert told["meshes"] == (
        "here.stl; gone.stl (missing); package://robot/a.dae; http://there/b.dae (http: is not looked up)"
    )
    assert told["left out"] == "<visual>: a scene graph has frames only (4)"
    assert "<limit velocity=…> must be greater than 0, not -1" in told["warnings"]
    assert (told["robot"], told["URDF"], told["joints"]) == ("r", "version 1.2", "1 revolute")


def test_meshes_with_impossible_names_are_described(tmp_path: Path) -> None:
    names = ("http://[", "a" * 5000, "%00", "a/../" * 50)
    shapes = "".join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>' for name in names)
    file = write(tmp_path, f'<robot><link name="a">{shapes}</link></robot>', "robot.urdf")
    first, long, null, up = describe_urdf(file)["meshes"].split("; ")
    assert first == "http://[ (no address)" and null == "%00 (missing)" and up.endswith("(missing)")
    assert len(long) == 300


def test_long_names_are_refused(tmp_path: Path) -> None:
    told = problems(write(tmp_path, f'<robot><link name="{"a" * 2000}"/></robot>', "robot.urdf"))
    assert told == ["robot.urdf:1: <link> name: longer than 1000 characters"]


XACRO = """\
<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="reach" value="0.25"/>
  <xacro:macro name="part" params="name"><link name="${name}"/></xacro:macro>
  <xacro:part name="a"/><xacro:part name="b"/>
  <joint name="j" type="fixed"><parent link="a"/><child link="b"/><origin xyz="${2*reach} 0 0"/></joint>
</robot>
"""


def test_xacro_files_are_expanded_by_xacro(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    file = write(tmp_path, XACRO, "robot.urdf.xacro")
    assert SceneGraph(read_scene(file)).pose("a", "b").x == 0.5
    assert "xacro:macro" not in urdf_text(file)


def test_without_xacro_the_error_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda *_args, **_options: None)
    told = problems(write(tmp_path, XACRO, "robot.urdf"))
    assert told[0].startswith(
        "robot.urdf:1: this file has xacro macros, and xacro is not installed: `pip install"
    )


def test_description_says_that_xacro_expanded_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake_xacro(tmp_path, monkeypatch, "print('<robot><link name=\"a\"/></robot>')")
    file = write(tmp_path, XACRO, "robot.urdf.xacro")
    assert describe_urdf(file)["URDF"] == "version 1.0, expanded by xacro"


def fake_xacro(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    folder = tmp_path / "bin"
    folder.mkdir()
    file = folder / "xacro"
    file.write_text(f"#!{sys.executable}\nimport sys, time\n{program}\n")
    file.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("time.sleep(60)", "xacro did not end within 0.5 s"),
        ("sys.exit('No such package: arm')", "xacro refuses it: No such package: arm"),
        ("while True: sys.stdout.write('<a>' * 100_000)", "xacro"),
        ("print('<robot>')", "not XML: no element found"),
    ],
)
def test_xacro_that_fails_is_bounded_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, said: str
) -> None:
    fake_xacro(tmp_path, monkeypatch, program)
    monkeypatch.setattr("robbie_mp.scene.xacro.TIMEOUT_S", 0.5 if "sleep" in program else 20.0)
    began_s = time.monotonic()
    with pytest.raises(SceneFileError, match=said):
        read_scene(write(tmp_path, XACRO, "robot.urdf"))
    assert time.monotonic() - began_s < 30.0
