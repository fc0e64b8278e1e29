"""The simulated camera shows known points of the arena where projective geometry puts them."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import ORIGIN, Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import (
    AppearingObstacle,
    ArenaVictim,
    HazardSign,
    SignKind,
    VictimKind,
    WallSpot,
)
from robbie_robots.hw.simulation.aruco import TAG_COUNT, tag_cells
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.camera import CameraNotPlaced, SimulatedCamera, SimulatedThermalCamera
from robbie_robots.hw.simulation.panel_textures import SIGN_COLOURS, SKIN

ROOM = Arena(box_segments(np.array([[0.0, 0.0, 6.0, 4.0]])), np.empty((0, 3)), ORIGIN, 6.0, 4.0)
EAST = WallSpot(6.0, 2.0, 0.35, math.pi)
VICTIM = ArenaVictim(17, VictimKind.STILL, EAST)
GEOMETRY = CameraGeometry()
EYE_Z = GEOMETRY.mount_m[2]
PAPER = np.array([245, 245, 245])


def image(
    arena: Arena,
    robot: Pose,
    pan: float = 0.0,
    tilt: float = 0.0,
    stamp_s: float = 0.0,
    kind: type[SimulatedCamera] = SimulatedCamera,
    **more: Any,
) -> np.ndarray:
    camera = kind(arena, **{"noise": 0.0, **more})
    camera.look(pan, tilt)
    camera.place(robot, stamp_s)
    frame = camera.capture()
    assert frame.stamp_s == stamp_s
    return frame.pixels.astype(int)


def pixel(
    point: tuple[float, float, float], robot: Pose, pan: float = 0.0, tilt: float = 0.0
) -> tuple[int, int]:
    """Row and column of a point, by rotation matrices and the pinhole model."""
    base = Rotation.from_euler("z", robot.heading_rad)
    head = base * Rotation.from_euler("z", pan) * Rotation.from_euler("y", tilt)
    eye = np.array([robot.x_m, robot.y_m, 0.0]) + base.apply(GEOMETRY.mount_m)
    ahead, left, up = head.inv().apply(np.asarray(point) - eye)
    focal = 160 / math.tan(math.radians(30))
    return round(119.5 - focal * up / ahead), round(159.5 - focal * left / ahead)


VIEWS = [
    (Pose(3.0, 2.0, 0.0), 0.0, 0.0),
    (Pose(4.5, 2.7, -0.7), 0.2, 0.1),
    (Pose(4.0, 1.0, 2.0), -1.5, -0.2),
    (Pose(5.0, 2.2, 0.3), -0.4, 0.15),
]


@pytest.mark.parametrize(("robot", "pan", "tilt"), VIEWS)
def test_tag_of_a_victim_appears_where_it_is_projected(robot: Pose, pan: float, tilt: float) -> None:
    seen = image(replace(ROOM, victims=(VICTIM,)), robot, pan, tilt)
    cells = tag_cells(17)
    for row in range(6):
        for column in range(6):
            # The tag is 0.25 m wide; seen from the front its first column is on the left, at greater y here.
            aside, above = (column - 2.5) * 0.25 / 6, (2.5 - row) * 0.25 / 6
            place = pixel((6.0, 2.0 - aside, 0.35 + above), robot, pan, tilt)
            assert (seen[place].mean() > 128) == cells[row, column], (row, column)


@pytest.mark.parametrize(("robot", "pan", "tilt"), VIEWS)
def test_sign_has_its_projected_size(robot: Pose, pan: float, tilt: float) -> None:
    sign = HazardSign(SignKind.FLAMMABLE_GAS, EAST)
    seen = image(replace(ROOM, signs=(sign,)), robot, pan, tilt)
    empty = image(ROOM, robot, pan, tilt)
    red = SIGN_COLOURS[SignKind.FLAMMABLE_GAS]
    for aside, above in [(0.0, 0.095), (0.0, -0.095), (0.095, 0.0), (-0.095, 0.0)]:
        place = pixel((6.0, 2.0 + aside, 0.35 + above), robot, pan, tilt)
        np.testing.assert_allclose(seen[place], red, atol=40)
    for aside, above in [(0.1, 0.1), (-0.1, 0.1), (0.0, 0.19), (0.19, 0.0)]:
        place = pixel((6.0, 2.0 + aside, 0.35 + above), robot, pan, tilt)
        assert seen[place].tolist() == empty[place].tolist()


@pytest.mark.parametrize(("robot", "pan", "tilt"), VIEWS)
def test_walls_begin_at_the_floor_and_end_at_their_height(robot: Pose, pan: float, tilt: float) -> None:
    seen = image(ROOM, robot, pan, tilt)
    for y in (1.9, 2.2):
        place = [pixel((6.0, y, z), robot, pan, tilt) for z in (-0.03, 0.03, 0.2, 1.15, 1.25)]
        floor, skirting, wall, top, sky = (seen[p] if 0 <= p[0] < 240 else None for p in place)
        if floor is not None:
            assert floor.tolist() in ([104, 106, 108], [124, 126, 128])
        assert sky is None or sky.tolist() == [214, 222, 230]
        assert top is None or wall is None or top.tolist() == wall.tolist()
        assert skirting is None or wall is None or np.all(skirting < 0.7 * wall)


def test_tiles_of_the_floor_are_half_a_metre_wide() -> None:
    robot = Pose(3.0, 2.0, 0.4)
    seen = image(ROOM, robot, tilt=0.3)
    shades = {}
    for x, y in [(4.2, 2.2), (4.2, 2.7), (3.7, 2.2), (3.7, 2.7), (4.7, 2.2)]:
        shades[x, y] = seen[pixel((x, y, 0.0), robot, tilt=0.3)][0]
    assert shades[4.2, 2.2] == shades[3.7, 2.7] != shades[4.2, 2.7] == shades[3.7, 2.2] == shades[4.7, 2.2]


def test_pillar_hides_objects_behind_it() -> None:
    victim = replace(ROOM, victims=(VICTIM,))
    robot = Pose(3.0, 2.0, 0.0)
    place = pixel((6.0, 2.0, 0.6), robot)  # its chin
    assert image(victim, robot)[pixel((6.0, 2.0, 0.35 + 0.15), robot)].tolist() == PAPER.tolist()
    hidden = image(replace(victim, circles=np.array([[5.0, 2.0, 0.2]])), robot)
    assert hidden[place].max() < 230 and np.ptp(hidden[place]) < 30
    beside = image(replace(victim, circles=np.array([[5.0, 2.6, 0.2]])), robot)
    assert beside[place].tolist() == image(victim, robot)[place].tolist()


def test_victim_is_not_seen_from_behind() -> None:
    wall = np.array([[4.0, 0.5, 4.0, 3.5]])
    arena = replace(ROOM, segments=np.concatenate([ROOM.segments, wall]))
    there = replace(arena, victims=(ArenaVictim(3, VictimKind.STILL, WallSpot(4.0, 2.0, 0.35, 0.0)),))
    robot = Pose(2.0, 2.0, 0.0)
    np.testing.assert_array_equal(image(there, robot), image(arena, robot))


def test_picture_beside_the_camera_is_visible_where_it_is_ahead() -> None:
    # Its middle is 0.12 m ahead of the eye and 0.15 m to its right: its far corner is seen, its near one
    # is behind the eye.
    robot = Pose(5.85, 1.78, math.pi / 2)
    sign = HazardSign(SignKind.OXIDIZER, EAST)
    seen = image(replace(ROOM, signs=(sign,)), robot, pan=-0.1)
    place = pixel((6.0, 2.1, 0.35), robot, pan=-0.1)
    assert 0 <= place[1] < 320
    np.testing.assert_allclose(seen[place], SIGN_COLOURS[SignKind.OXIDIZER], atol=5)


def test_only_moving_victims_move() -> None:
    for kind, moves in [(VictimKind.STILL, False), (VictimKind.MOVING, True), (VictimKind.COLD, False)]:
        arena = replace(ROOM, victims=(replace(VICTIM, kind=kind),))
        first, second = (image(arena, Pose(4.0, 2.0, 0.0), stamp_s=stamp) for stamp in (0.1, 0.6))
        assert np.array_equal(first, second) != moves


def test_obstacle_that_has_appeared_is_visible() -> None:
    person = AppearingObstacle((5.0, 2.0, 0.2), from_s=0.0)
    arena = replace(ROOM, appearing=(person,))
    camera = SimulatedCamera(arena, noise=0.0)
    camera.place(Pose(3.0, 2.0, 0.0), 0.0)
    before = camera.capture().pixels
    camera.arena = arena.with_obstacles([0])
    changed = np.abs(camera.capture().pixels.astype(int) - before).sum(axis=2) > 0
    assert changed[pixel((4.8, 2.0, 0.3), Pose(3.0, 2.0, 0.0))]
    assert not changed[:, :100].any()


@pytest.mark.parametrize(("robot", "pan", "tilt"), VIEWS)
def test_warm_victims_are_warm_and_cold_ones_are_not(robot: Pose, pan: float, tilt: float) -> None:
    chin = pixel((6.0, 2.0, 0.35 + 66 * 0.25 / 48), robot, pan, tilt)
    for kind, celsius in [(VictimKind.STILL, 35.0), (VictimKind.MOVING, 35.0), (VictimKind.COLD, 20.0)]:
        arena = replace(ROOM, victims=(replace(VICTIM, kind=kind),))
        heat = image(arena, robot, pan, tilt, kind=SimulatedThermalCamera)
        colours = image(arena, robot, pan, tilt)
        if 0 <= chin[0] < 240:
            assert heat[chin] / 100 - 273.15 == pytest.approx(celsius, abs=0.01)
            assert colours[chin].tolist() == list(SKIN)


def test_noise_has_its_standard_deviation_and_depends_on_the_seed() -> None:
    arena = replace(ROOM, victims=(VICTIM,))
    robot = Pose(3.0, 2.0, 0.0)
    exact = image(arena, robot)
    noisy = [image(arena, robot, noise=3.0, seed=seed) for seed in (1, 1, 2)]
    inside = (exact > 20) & (exact < 235)
    assert (noisy[0] - exact)[inside].std() == pytest.approx(3.0, rel=0.05)
    np.testing.assert_array_equal(noisy[0], noisy[1])
    assert not np.array_equal(noisy[0], noisy[2])
    heat = image(arena, robot, kind=SimulatedThermalCamera)
    noise = image(arena, robot, kind=SimulatedThermalCamera, noise=5.0) - heat
    assert noise.std() == pytest.approx(5.0, rel=0.05)


def test_image_of_a_camera_before_it_is_placed_is_an_error() -> None:
    with pytest.raises(CameraNotPlaced, match="place"):
        SimulatedCamera(ROOM).capture()


def test_tag_outside_the_dictionary_is_an_error() -> None:
    with pytest.raises(ValueError, match="0 to 49"):
        tag_cells(TAG_COUNT)


def test_tags_are_those_of_opencv() -> None:
    aruco = pytest.importorskip("cv2").aruco
    dictionary = aruco.getPredefinedDictionary(aruco.DICT_4X4_50)
    for tag in range(TAG_COUNT):
        theirs = aruco.generateImageMarker(dictionary, tag, 6) > 128
        np.testing.assert_array_equal(tag_cells(tag), theirs)


@pytest.mark.parametrize("kind", VictimKind)
@pytest.mark.parametrize("aside_rad", [-0.5, 0.0, 0.5])
def test_opencv_finds_tags_from_half_a_metre_to_three_metres(kind: VictimKind, aside_rad: float) -> None:
    aruco = pytest.importorskip("cv2").aruco
    detector = aruco.ArucoDetector(aruco.getPredefinedDictionary(aruco.DICT_4X4_50))
    camera = SimulatedCamera(replace(ROOM, victims=(replace(VICTIM, kind=kind),)))
    for distance_m in np.arange(0.6, 3.2, 0.25):
        x, y = distance_m * math.cos(aside_rad), distance_m * math.sin(aside_rad)
        camera.place(Pose(6.0 - x, 2.0 + y, -aside_rad).plus(Pose(-0.1, 0.0, 0.0)), 0.1)
        grey = np.ascontiguousarray(camera.capture().pixels[:, :, 1])
        _, tags, _ = detector.detectMarkers(grey)
        assert tags is not None and tags.ravel().tolist() == [17], distance_m
