"""Tables and objects are found in depth images, named by their size, and placed."""

import math

import numpy as np
import pytest

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.simulation.depth_camera import SimulatedDepthCamera
from robbie_robots.hw.simulation.solid import Placed, Solid, pose_at
from robbie_robots.workers.manipulation.collisions import Shape
from robbie_robots.workers.manipulation.grasps import grasps, moved_along, places
from robbie_robots.workers.manipulation.table_view import (
    KnownObject,
    TableFinder,
    TableView,
    points_of,
    smallest_rectangle,
)

GEOMETRY = CameraGeometry(200, 150, 1.0)
KNOWN = [
    KnownObject("soup", (0.066, 0.066, 0.1), True),
    KnownObject("tea", (0.04, 0.06, 0.12), False),
    KnownObject("cola", (0.052, 0.052, 0.14), True),
]
TABLE = Placed(Solid((0.6, 1.2, 0.4)), pose_at((0.6, 0.0, 0.2)))


def seen(objects: list[Placed], seed: int = 0) -> TableView | None:
    """What the finder sees from a mast at x = -0.1 m, 1 m high, 0.75 rad down."""
    sin, cos = math.sin(0.75), math.cos(0.75)
    camera = np.eye(4)
    camera[:3, 0], camera[:3, 1], camera[:3, 2] = (0, -1, 0), (-sin, 0, -cos), (cos, 0, -sin)
    camera[:3, 3] = (-0.1, 0.0, 1.0)
    depths = SimulatedDepthCamera(GEOMETRY, seed=seed).capture(camera, objects)
    focal = GEOMETRY.focal_length_px
    points = points_of(depths, focal, GEOMETRY.centre_px) @ camera[:3, :3].T + camera[:3, 3]
    return TableFinder(KNOWN, seed=seed).find(points, 1.5, 1 / focal, camera[:3, 3])


def test_objects_are_named_and_placed_within_a_few_millimetres() -> None:
    chance = np.random.default_rng(0)
    errors, turns = [], []
    for seed in range(12):
        yaw = float(chance.uniform(-math.pi, math.pi))
        shift = float(chance.uniform(-0.03, 0.03))
        truth = {"soup": (0.42, shift), "tea": (0.46 + shift, 0.2), "cola": (0.44, -0.2)}
        placed = [
            Placed(Solid(one.size_m, one.is_round), pose_at((*truth[one.name], 0.4 + one.size_m[2] / 2), yaw))
            for one in KNOWN
        ]
        view = seen([TABLE, *placed], seed)
        assert view is not None
        assert view.top_m == pytest.approx(0.4, abs=0.002)
        assert {one.name for one in view.objects} == {"soup", "tea", "cola"}
        errors += [math.dist(one.pose[:2, 3], truth[one.name]) for one in view.objects]
        tea = view.named("tea")
        assert tea is not None
        turned = math.atan2(tea.pose[1, 0], tea.pose[0, 0]) - yaw
        turns.append(abs(math.remainder(turned, math.pi)))
    assert max(errors) < 0.008
    assert max(turns) < 0.2


def test_unknown_things_are_shown_and_nothing_is_taken_for_a_table() -> None:
    brick = Placed(Solid((0.1, 0.2, 0.1)), pose_at((0.45, 0.0, 0.45)))
    view = seen([TABLE, brick])
    assert view is not None
    assert [one.name for one in view.objects] == ["unknown 0"]
    assert view.objects[0].size_m == pytest.approx((0.2, 0.1, 0.1), abs=0.015)
    assert view.named("soup") is None
    assert seen([]) is None
    # The front of a cupboard is no table.
    assert seen([Placed(Solid((0.6, 2.0, 2.0)), pose_at((0.8, 0.0, 1.0)))]) is None


def test_smallest_rectangle_is_that_of_the_points() -> None:
    x, y = np.meshgrid(np.linspace(-0.05, 0.05, 21), np.linspace(-0.02, 0.02, 9))
    points = np.column_stack([x.ravel(), y.ravel()])
    turn = np.array([[math.cos(2.0), math.sin(2.0)], [-math.sin(2.0), math.cos(2.0)]])
    middle, (length, width), angle = smallest_rectangle(points @ turn + [0.3, 0.1])
    assert middle == pytest.approx((0.3, 0.1), abs=0.002)
    assert (length, width) == pytest.approx((0.1, 0.04), abs=0.003)
    assert math.remainder(angle - 2.0, math.pi) == pytest.approx(0.0, abs=0.02)


def test_fingers_close_across_the_narrow_enough_sides() -> None:
    shoulder = np.array([0.1, 0.0, 0.4])
    tea = Shape("tea", (0.06, 0.04, 0.12), pose_at((0.45, 0.1, 0.46), 0.3))
    around = list(grasps(tea, 0.4, shoulder, 0.045))
    across = {round(abs(float(pose[:3, 1] @ tea.pose[:3, 0])), 3) for pose in around}
    assert across == {0.0, 1.0}  # the fingers are parallel to its sides
    assert all(pose[2, 3] >= 0.44 for pose in around)
    assert all(abs(np.linalg.det(pose[:3, :3]) - 1) < 1e-9 for pose in around)
    long = Shape("long", (0.2, 0.04, 0.12), pose_at((0.45, 0.1, 0.46), 0.3))
    assert all(abs(pose[:3, 1] @ long.pose[:3, 1]) > 0.99 for pose in grasps(long, 0.4, shoulder, 0.045))
    wide = Shape("wide", (0.09, 0.09, 0.1), pose_at((0.45, 0.0, 0.45)), is_round=True)
    assert list(grasps(wide, 0.4, shoulder, 0.045)) == []


def test_places_are_on_the_table_upright_and_free() -> None:
    table = Shape("table", (0.4, 0.8, 0.4), pose_at((0.5, 0.0, 0.2)))
    soup = Shape("soup", (0.066, 0.066, 0.1), pose_at((0.45, 0.0, 0.45)), is_round=True)
    shoulder = np.array([0.1, 0.0, 0.4])
    grasp = next(grasps(soup, 0.4, shoulder, 0.045))
    held = Shape("soup", soup.size_m, np.linalg.inv(grasp) @ soup.pose, is_round=True)
    blocking = Shape("tea", (0.06, 0.04, 0.12), pose_at((0.43, 0.0, 0.46)))
    poses = [hand @ held.pose for hand in places(TableView(0.0, table, (blocking,)), held, shoulder)]
    assert len(poses) > 20
    for pose in poses:
        assert pose[2, 2] == pytest.approx(1.0)
        assert pose[2, 3] - 0.05 == pytest.approx(0.404)
        assert abs(pose[0, 3] - 0.5) <= 0.15 + 1e-6 and abs(pose[1, 3]) <= 0.35 + 1e-6
        assert math.dist(pose[:2, 3], (0.43, 0.0)) > 0.033 + 0.05
    full = tuple(Shape(str(n), (0.1, 0.1, 0.1), pose_at((0.5, -0.3 + 0.1 * n, 0.45))) for n in range(7))
    near = Shape("table", (0.2, 0.8, 0.4), pose_at((0.5, 0.0, 0.2)))
    assert list(places(TableView(0.0, near, full), held, shoulder)) == []
    assert moved_along(grasp, -0.1)[:3, 3] == pytest.approx(grasp[:3, 3] - 0.1 * grasp[:3, 0])


def test_board_under_another_board_is_no_table() -> None:
    steps = np.linspace(0.46, 0.74, 60)
    x, y = np.meshgrid(steps, np.linspace(-0.5, 0.5, 120))
    board = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.4)])
    upper = board[::2] + np.array([0.0, 0.0, 0.3])
    assert TableFinder(KNOWN).find(board, 1.5, 0.005, np.zeros(3)) is not None
    assert TableFinder(KNOWN).find(np.concatenate([board, upper]), 1.5, 0.005, np.zeros(3)) is None


@pytest.mark.parametrize("yaw_rad", [-0.25, 0.0, 0.1, 0.25])
def test_places_on_a_small_table_before_a_wall_are_on_that_table(yaw_rad: float) -> None:
    X_BT = pose_at((0.47, 0.03, 0.2), yaw_rad)
    sideboard = Placed(Solid((0.25, 0.6, 0.4)), X_BT)
    wall = Placed(Solid((0.02, 3.0, 2.4)), X_BT @ pose_at((0.135, 0.0, 1.0)))
    tea = Placed(Solid((0.04, 0.06, 0.12)), X_BT @ pose_at((-0.02, 0.02, 0.26)))
    view = seen([sideboard, wall, tea])
    assert view is not None
    assert sorted(view.table.size_m[:2]) == pytest.approx([0.25, 0.6], abs=0.03)
    held = Shape("cola", (0.052, 0.052, 0.14), pose_at((0.0, 0.0, 0.0)), is_round=True)
    found = [hand[:2, 3] for hand in places(view, held, np.array([0.1, 0.0, 0.4]))]
    on_table = (np.array(found) - X_BT[:2, 3]) @ X_BT[:2, :2]
    assert len(found) >= 10
    assert (np.array([0.125, 0.3]) - np.abs(on_table)).min() > 0.035
    assert np.hypot(*(on_table - [-0.02, 0.02]).T).min() > 0.07
