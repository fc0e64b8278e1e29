"""Boxes and cylinders: what is within, where rays hit, and what a URDF says of them."""

import math
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.hw.simulation.solid import Placed, Solid, pose_at
from robbie_robots.hw.simulation.urdf_solids import UrdfShapeError, read_urdf_solids
from tests._support.places import PROJECT

BOX, CAN = Solid((0.2, 0.4, 0.6)), Solid((0.2, 0.2, 0.6), is_round=True)


@pytest.mark.parametrize("solid", [BOX, CAN])
def test_points_of_the_surface_are_within_unless_they_must_be_deep(solid: Solid) -> None:
    points = solid.surface(0.01)
    assert solid.contains(points * 0.999).all()
    assert not solid.contains(points * 0.999, deeper_than_m=0.01).any()
    assert not solid.contains(points * 1.001).any()


@pytest.mark.parametrize("solid", [BOX, CAN])
def test_rays_end_on_the_surface(solid: Solid) -> None:
    random = np.random.default_rng(1)
    origin = np.array([1.0, 0.8, 0.9])
    aims = random.uniform(-0.6, 0.6, (500, 3))
    directions = aims - origin
    ranges = solid.ranges_m(origin, directions)
    hits = np.isfinite(ranges)
    assert 30 < hits.sum() < 470
    ends = origin + directions[hits] * ranges[hits, None]
    assert solid.contains(ends * 0.9999).all()
    assert not solid.contains(ends, deeper_than_m=1e-6).any()
    # What misses has no point within.
    shares = np.linspace(0.0, 3.0, 100)[:, None, None]
    assert not solid.contains((origin + directions[~hits] * shares).reshape(-1, 3)).any()


def test_rays_along_the_axis_of_a_cylinder_hit_its_top_only() -> None:
    down = np.array([[0.0, 0.0, -1.0]])
    assert CAN.ranges_m(np.array([0.05, 0.0, 1.0]), down) == pytest.approx([0.7])
    assert CAN.ranges_m(np.array([0.15, 0.0, 1.0]), down)[0] == math.inf


def test_placed_solids_know_what_is_within_and_near() -> None:
    placed = Placed(BOX, pose_at((1.0, 0.0, 0.3), math.pi / 2))
    assert placed.contains(np.array([[1.19, 0.0, 0.3], [1.0, 0.19, 0.3]])).tolist() == [True, False]
    assert placed.is_near(Placed(CAN, pose_at((1.5, 0.0, 0.3))))
    assert not placed.is_near(Placed(CAN, pose_at((2.0, 0.0, 0.3))))


def test_urdf_gives_each_link_its_shapes(tmp_path: Path) -> None:
    shapes = {shape.link: shape for shape in read_urdf_solids(PROJECT / "hw/robots/home.urdf")}
    assert shapes["base_link"].solid == Solid((0.4, 0.4, 0.28), is_round=True)
    assert shapes["left_finger"].pose[:3, 3] == pytest.approx([0.0, 0.006, 0.0])
    assert "laser" not in shapes
    file = tmp_path / "ball.urdf"
    file.write_text(
        '<robot><link name="a"><collision><geometry><sphere radius="1"/></geometry></collision></link>'
        "</robot>"
    )
    with pytest.raises(UrdfShapeError, match=r"ball\.urdf.*box or a cylinder"):
        read_urdf_solids(file)


@pytest.mark.parametrize(
    ("version", "turn", "corner"),
    [
        ("1.1", 'quat_xyzw="0 0 1 1"', [0.0, 1.0, 0.0]),
        ("1.2", 'quat_xyzw="1 0 0 0"', [1.0, 0.0, 0.0]),
        ("1.0", 'quat_xyzw="0 0 1 1"', [1.0, 0.0, 0.0]),
        ("1.0", 'rpy="0 0 1.5707963267948966"', [0.0, 1.0, 0.0]),
    ],
)
def test_shapes_are_turned_by_quaternions_since_urdf_1_1(
    tmp_path: Path, version: str, turn: str, corner: list[float]
) -> None:
    file = tmp_path / "box.urdf"
    shape = f'<collision><origin {turn}/><geometry><box size="1 1 1"/></geometry></collision>'
    file.write_text(f'<robot version="{version}"><link name="a">{shape}</link></robot>')
    (solid,) = read_urdf_solids(file)
    assert solid.pose[:3, 0] == pytest.approx(corner)


def test_macros_are_not_read_as_a_robot_without_shapes(tmp_path: Path) -> None:
    file = tmp_path / "box.urdf"
    file.write_text('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:box/></robot>')
    with pytest.raises(UrdfShapeError, match="expand its macros first"):
        read_urdf_solids(file)
