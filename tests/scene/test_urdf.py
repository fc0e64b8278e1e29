"""URDFs give the same tree as pytransform3d, and invalid ones give errors."""

import warnings
from pathlib import Path

import pytest
from numpy.testing import assert_allclose
from pytransform3d.urdf import UrdfTransformManager

from robbie_mp.scene import JointType, Mimic, SceneGraph, read_scene
from tests.scene.test_scene_file import problems, write

ARM = """\
<?xml version="1.0"?>
<robot name="arm">
  <material name="grey"/>
  <link name="base"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <link name="shoulder"/> <link name="elbow"/> <link name="slide"/> <link name="tool"/> <link name="wheel"/>
  <joint name="turn" type="revolute">
    <parent link="base"/> <child link="shoulder"/>
    <origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/>
    <axis xyz="1 2 2"/> <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="bend" type="revolute">
    <parent link="shoulder"/> <child link="elbow"/> <origin xyz="0 0 0.5"/>
    <limit lower="-1" upper="1.5"/>
  </joint>
  <joint name="push" type="prismatic">
    <parent link="elbow"/> <child link="slide"/> <origin rpy="0 1.5 0"/>
    <axis xyz="0 1 0"/> <limit upper="0.4"/>
  </joint>
  <joint name="bolts" type="fixed">
    <parent link="slide"/> <child link="tool"/> <origin xyz="0.01 0 0" rpy="3.1 0 -3.1"/>
  </joint>
  <joint name="roll" type="continuous">
    <parent link="base"/> <child link="wheel"/> <axis xyz="0 -1 0"/>
  </joint>
</robot>
"""


def test_greatest_speeds_are_read_and_may_be_missing(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    graph = SceneGraph(read_scene(file))
    assert (graph.joint("turn").max_speed, graph.joint("bend").max_speed) == (1.0, None)


def test_tree_agrees_with_that_of_pytransform3d(tmp_path: Path) -> None:
    graph = SceneGraph(read_scene(write(tmp_path, ARM, "arm.urdf")))
    oracle = UrdfTransformManager()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        oracle.load_urdf(ARM)
    assert graph.joint("turn").limits == (-2.0, 2.0)
    assert graph.joint("roll").type is JointType.CONTINUOUS
    for positions in ((0.0, 0.0, 0.0, 0.0), (1.2, -0.7, 0.3, 2.5)):
        for joint, position in zip(("turn", "bend", "push", "roll"), positions, strict=True):
            graph.set_joint(joint, 0, position)
            oracle.set_joint(joint, position)
        for a in graph:
            for b in graph:
                ours = graph.pose(a.name, b.name, 0).matrix
                assert_allclose(ours, oracle.get_transform(b.name, a.name), rtol=0.0, atol=1e-9)


def test_urdf_with_mimic_joints_can_be_included_with_a_prefix(tmp_path: Path) -> None:
    mimic = '<axis xyz="0 1 0"/> <mimic joint="bend" multiplier="-2" offset="0.1"/>'
    write(tmp_path, ARM.replace('<axis xyz="0 1 0"/>', mimic), "arm.urdf")
    scene = write(tmp_path, "nodes: {body: }\ninclude:\n  - {file: arm.urdf, prefix: left/, parent: body}\n")
    graph = SceneGraph(read_scene(scene))
    assert graph.node("left/base").parent == "body"
    slide = graph.node("left/slide").joint
    assert slide is not None and slide.mimic == Mimic("left/bend", -2.0, 0.1)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<robot ", "<robt ", "25: not XML: mismatched tag"),
        ("?>\n", '?><!DOCTYPE r [<!ENTITY e "ha">]>', "1: a document type (<!DOCTYPE …>) with its entities"),
        ('version="1.0"', 'version="1.0" encoding="klingon"', "1: not XML: unknown encoding"),
        ('type="continuous"', 'type="screw"', "22: joint 'roll': type 'screw' is not supported; known are"),
        (
            '<limit lower="-1" upper="1.5"/>',
            '<limit lower="-1,5"/>',
            "13: <limit> lower: expected a",
        ),
        (
            '<limit lower="-1" upper="1.5"/>',
            '<limit lower="1_0"/>',
            "13: <limit> lower: expected a",
        ),
        ('xyz="0 0 0.5"', 'xyz="0 0 nan"', "12: <origin> xyz: expected three numbers; got '0 0 nan'"),
        ('name="bolts"', 'name="push"', "19: joint 'push' is described twice, first at arm.urdf:15"),
        ('name="bolts"', 'name=""', "19: <joint> has no name"),
        ('xyz="0 -1 0"', 'xyz="0 0 0"', "22: the axis of joint 'roll' must have a direction; got (0.0, 0"),
        ('xyz="0 -1 0"', 'xyz="0 -1"', "23: <axis> xyz: expected three numbers; got '0 -1'"),
        ('<limit upper="0.4"/>', "", "15: joint 'push' is prismatic, so it needs a <limit lower=… upper="),
        ('<limit upper="0.4"/>', '<limit upper="much"/>', "17: <limit> upper: expected a number; got 'much'"),
        (
            '<parent link="elbow"/>',
            '<parent link="elbo"/>',
            "15: joint 'push': its parent 'elbo' is not a link; did",
        ),
        ('<parent link="slide"/>', "", "19: joint 'bolts' has no <parent link=…>"),
        (
            '<child link="tool"/>',
            '<child link="wheel"/>',
            "22: link 'wheel' is the child of two joints, also at",
        ),
        (
            '<child link="tool"/>',
            '<child link="base"/>',
            "19: nodes hang on one another: base on slide on elb",
        ),
        (
            '<link name="elbow"/>',
            '<link name="elbow"/><link name="elbow"/>',
            "11: node 'elbow' is described twice",
        ),
    ],
)
def test_invalid_urdfs_are_refused_with_the_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in ARM
    told = problems(write(tmp_path, ARM.replace(old, new, 1), "arm.urdf"))
    assert any(each.startswith(f"arm.urdf:{said}") for each in told), told


def test_several_roots_cannot_be_attached(tmp_path: Path) -> None:
    write(tmp_path, ARM.replace('<link name="tool"/>', '<link name="tool"/><link name="x"/>'), "arm.urdf")
    told = problems(write(tmp_path, "nodes: {body: }\ninclude:\n  - {file: arm.urdf, parent: body}\n"))
    assert told == [
        "scene.yaml:3: arm.urdf has several roots ('base', 'x'); only a tree with one root can be attached"
    ]


def test_deep_nesting_and_other_xml_are_refused(tmp_path: Path) -> None:
    assert "nested deeper than 64" in problems(write(tmp_path, "<robot>" + "<a>" * 100, "arm.urdf"))[0]
    assert (
        "the root element of a URDF is <robot>, not <html>"
        in problems(write(tmp_path, "<html/>", "arm.urdf"))[0]
    )
