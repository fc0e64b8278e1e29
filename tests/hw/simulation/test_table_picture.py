"""Pictures of tables show printed objects where the depth camera measures them."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.simulation.depth_camera import ON_FLOOR, ON_NOTHING, SimulatedDepthCamera
from robbie_robots.hw.simulation.object_prints import PLAIN, ObjectPrint, drawn_print
from robbie_robots.hw.simulation.solid import Placed, Solid, pose_at
from robbie_robots.hw.simulation.table_picture import Printed, TablePictures

COARSE, FINE = CameraGeometry(80, 60, 1.0), CameraGeometry(320, 240, 1.0)
TABLE = Placed(Solid((0.6, 1.2, 0.4)), pose_at((0.6, 0.0, 0.2)))
BOX = Solid((0.06, 0.04, 0.12))
BROWN, BLACK = (150, 110, 70), (0, 0, 0)


def looking_at_the_table() -> NDArray[np.float64]:
    sin, cos = math.sin(0.75), math.cos(0.75)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = (0, -1, 0), (-sin, 0, -cos), (cos, 0, -sin)
    pose[:3, 3] = (-0.1, 0.0, 1.0)
    return pose


def picture_of(objects: list[Printed], *behind: Placed, light: float = 1.0) -> NDArray[np.uint8]:
    pose = looking_at_the_table()
    view = SimulatedDepthCamera(COARSE).view(pose, [TABLE, *behind])
    pictures = TablePictures(FINE, noise=0.0, light=light)
    return pictures.capture(pose, view, [BROWN, *[BLACK] * len(behind)], objects)


def box_at(x: float, y: float, seed: int | None, yaw: float = 0.3) -> Printed:
    return Printed(Placed(BOX, pose_at((x, y, 0.46), yaw)), ObjectPrint(BOX, seed))


def test_object_is_in_the_picture_where_the_depth_camera_measures_it() -> None:
    one = box_at(0.45, 0.1, seed=3)
    pose = looking_at_the_table()
    view = SimulatedDepthCamera(FINE).view(pose, [TABLE, one.placed])
    is_object = view.shapes == 1
    assert is_object.sum() > 500
    is_painted = (picture_of([one]) != picture_of([])).any(axis=2)
    assert (is_painted != is_object).sum() < 0.1 * is_object.sum()  # at its edge


def test_view_says_which_shape_each_pixel_shows() -> None:
    view = SimulatedDepthCamera(COARSE).view(looking_at_the_table(), [TABLE])
    assert set(np.unique(view.shapes)) == {ON_FLOOR, 0}
    up = looking_at_the_table()
    up[:3, 1:3] *= -1
    assert set(np.unique(SimulatedDepthCamera(COARSE).view(up, [TABLE]).shapes)) == {ON_NOTHING}


def test_nearer_things_hide_an_object() -> None:
    far = box_at(0.5, 0.0, seed=3)
    wall = Placed(Solid((0.02, 0.6, 0.4)), pose_at((0.4, 0.0, 0.6)))
    assert (picture_of([far], wall) == picture_of([], wall)).all()
    near = box_at(0.4, 0.0, seed=4)
    both = picture_of([far, near])
    assert (both == picture_of([near, far])).all()
    is_near = (picture_of([near]) != picture_of([])).any(axis=2)
    assert (both[is_near] == picture_of([near])[is_near]).mean() > 0.98


def test_each_print_and_each_face_is_another_one_and_a_print_is_always_the_same() -> None:
    faces = [picture_of([box_at(0.45, 0.0, 3, yaw)]).astype(int) for yaw in (0.0, math.pi / 2, math.pi)]
    other = picture_of([box_at(0.45, 0.0, 4, 0.0)]).astype(int)
    for one in (*faces[1:], other):
        assert np.abs(one - faces[0]).mean() > 0.1
    assert (drawn_print(3, 0.04, 0.12) == drawn_print(3, 0.04, 0.12)).all()
    assert drawn_print(3, 0.04, 0.12).shape == (300, 100, 3)


def test_can_has_its_print_around_it_and_a_plain_lid() -> None:
    can = Solid((0.066, 0.066, 0.1), is_round=True)
    printed = ObjectPrint(can, 5)
    angles = np.linspace(-3.0, 3.0, 50)
    side = np.column_stack([0.033 * np.cos(angles), 0.033 * np.sin(angles), np.zeros(50)])
    assert len(np.unique(printed.colours(side, np.eye(3)), axis=0)) > 10
    lid = np.column_stack([side[:, :2] * 0.5, np.full(50, 0.05)])
    assert np.ptp(printed.colours(lid, np.eye(3)), axis=0).max() == 0.0
    plain = ObjectPrint(can, None).colours(lid, np.eye(3))
    assert plain == pytest.approx(np.tile(PLAIN, (50, 1)), rel=0.1)


def test_light_and_noise_change_every_pixel_a_little() -> None:
    bright, dark = picture_of([box_at(0.45, 0.0, 3)]), picture_of([box_at(0.45, 0.0, 3)], light=0.5)
    assert dark.mean() == pytest.approx(0.5 * bright.mean(), rel=0.02)
    pose, pictures = looking_at_the_table(), TablePictures(FINE, noise=2.0, seed=1)
    view = SimulatedDepthCamera(COARSE).view(pose, [TABLE])
    one, other = (pictures.capture(pose, view, [BROWN], []).astype(int) for _ in range(2))
    assert 2.0 < float((one - other).std()) < 3.5


def test_object_beside_or_behind_the_camera_is_not_drawn() -> None:
    empty = picture_of([])
    for x, y in ((-0.5, 0.0), (0.45, 3.0)):
        assert (picture_of([box_at(x, y, 3)]) == empty).all()
