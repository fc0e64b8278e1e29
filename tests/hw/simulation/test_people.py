"""Simulated people walk, swing their legs, stop for the robot, and are seen by laser and camera."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.laser import LaserGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import ArenaPerson
from robbie_robots.hw.simulation.arena_file import ArenaError, read_arena
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.camera import SimulatedCamera
from robbie_robots.hw.simulation.drive import SimulatedDrive
from robbie_robots.hw.simulation.laser import SimulatedLaser
from robbie_robots.hw.simulation.people import (
    LEG_RADIUS_M,
    PICTURE_S,
    ROBOT_APART_M,
    FacesError,
    WalkingPeople,
    leg_circles,
    read_heads,
)
from tests._support.places import ARENAS

FAR_AWAY = Pose(0.5, 9.5, 0.0)
WALLS = box_segments(np.array([[0.0, 0.0, 10.0, 10.0]]))
ANNA = ArenaPerson("Anna", ((2.0, 5.0, 0.0), (8.0, 5.0, 1.0)), speed_m_per_s=0.6)
ROOM = Arena(WALLS, np.empty((0, 3)), Pose(1.0, 5.0, 0.0), 10.0, 10.0, 2.4, people=(ANNA,))


def walked(people: WalkingPeople, until_s: float, robot: Pose = FAR_AWAY) -> WalkingPeople:
    people.walk_until(0.0, robot)
    people.walk_until(until_s, robot)
    return people


def test_person_walks_at_its_speed_to_the_end_waits_there_and_comes_back() -> None:
    people = walked(WalkingPeople([ANNA]), 5.0)
    assert people.states[0].x_m == pytest.approx(5.0)
    people.walk_until(10.5, FAR_AWAY)
    assert people.states[0][:2] == (8.0, 5.0)
    people.walk_until(13.0, FAR_AWAY)
    assert people.states[0].x_m == pytest.approx(8.0 - 0.6 * 2.0, abs=0.04)
    assert people.states[0].heading_rad == pytest.approx(math.pi) or people.states[0].heading_rad < -3.0


def test_motion_does_not_depend_on_how_often_it_is_asked_for() -> None:
    often, rarely = WalkingPeople([ANNA]), walked(WalkingPeople([ANNA]), 17.0)
    for tenth in range(171):
        often.walk_until(tenth / 10, FAR_AWAY)
    assert often.states == rarely.states


def test_standing_foot_stays_on_the_ground_while_the_other_one_swings() -> None:
    people = WalkingPeople([ANNA])
    people.walk_until(0.0, FAR_AWAY)
    legs = []
    for tick in range(60, 140):
        people.walk_until(tick / 20, FAR_AWAY)
        legs.append(leg_circles(people.shown)[:, :2])
    steps = np.hypot(*np.diff(np.array(legs), axis=0).transpose(2, 0, 1))  # (ticks, 2 legs)
    slow, fast = steps.min(axis=1), steps.max(axis=1)
    assert np.mean(slow < 0.003) > 0.85  # all but the moments in which the feet change
    assert fast.max() > 0.055  # faster than the body, which moves by 0.03 m
    assert {0, 1} == set(steps.argmin(axis=1).tolist())
    apart = np.hypot(*(np.array(legs)[:, 0] - np.array(legs)[:, 1]).T)
    assert 0.15 < apart.min() < 0.22 and 0.4 < apart.max() < 0.55


def test_person_stops_before_the_robot_and_goes_on_when_it_has_left() -> None:
    in_the_way = Pose(4.0, 5.0, 0.0)
    people = walked(WalkingPeople([ANNA]), 4.0, in_the_way)
    assert 4.0 - people.states[0].x_m == pytest.approx(ROBOT_APART_M, abs=0.04)
    assert people.states[0].stride == 0.0
    people.walk_until(7.0, FAR_AWAY)
    assert people.states[0].x_m > 4.0


def test_person_whose_way_stays_blocked_walks_back() -> None:
    people = walked(WalkingPeople([ANNA]), 7.0, Pose(4.0, 5.0, 0.0))
    assert people.states[0].x_m < 3.0


def test_person_who_crosses_passes_between_the_first_one_and_the_robot_behind() -> None:
    crosser = ArenaPerson("Ben", ((5.0, 3.5, 0.0), (5.0, 6.5, 0.0)), speed_m_per_s=0.7, crosses=True)
    people = WalkingPeople([ANNA, crosser])
    people.walk_until(0.0, FAR_AWAY)
    for tick in range(220):
        people.walk_until(tick / 20, FAR_AWAY)
        first, other = people.states
        if other.y_m >= 5.0:
            break
    assert 0.4 < first.x_m - other.x_m < 1.2


def test_restored_people_go_on_from_where_they_were() -> None:
    people = walked(WalkingPeople([ANNA]), 6.0)
    again = WalkingPeople([ANNA], [tuple(state) for state in people.states])
    assert again.states == people.states
    for one in (people, again):
        one.walk_until(6.0, FAR_AWAY)
        one.walk_until(8.0, FAR_AWAY)
    assert again.states == people.states


def test_laser_sees_two_legs() -> None:
    geometry = LaserGeometry(angle_increment_rad=math.tau / 1024, beams=1024)
    laser = SimulatedLaser(ROOM.with_circles(leg_circles(WalkingPeople([ANNA]).shown)), geometry, 0.0, 0.0)
    laser.place(Pose(1.0, 5.0, 0.0), 0.0)
    ranges, angles = laser.scan().ranges_m, geometry.angles_rad()
    near = (ranges < 1.1) & (np.cos(angles) > 0.0)
    ends = ranges[near, None] * np.stack([np.cos(angles[near]), np.sin(angles[near])], 1)
    for side in (0.09, -0.09):
        leg = ends[np.sign(ends[:, 1]) == np.sign(side)]
        assert len(leg) > 10
        np.testing.assert_allclose(np.hypot(leg[:, 0] - 1.0, leg[:, 1] - side), LEG_RADIUS_M, atol=2e-3)


def test_camera_sees_a_figure_in_its_own_clothes_and_a_wall_hides_it() -> None:
    red = replace(ANNA, shirt=(200, 20, 20), trousers=(20, 20, 200))
    geometry = CameraGeometry(200, 160, 1.2, (0.0, 0.0, 1.1))
    for wall, is_seen in (([], True), ([[1.5, 0.0, 1.5, 10.0]], False)):
        segments = np.concatenate([WALLS, np.array(wall).reshape(-1, 4)])
        camera = SimulatedCamera(replace(ROOM, segments=segments, people=(red,)), geometry, noise=0.0)
        camera.people = WalkingPeople([red]).shown
        camera.place(Pose(1.0, 5.0, 0.0), 0.0)
        pixels = camera.capture().pixels.astype(int)
        shirt = (pixels[..., 0] > 150) & (pixels[..., 1] < 50)
        assert shirt.any() == is_seen
        if is_seen:
            rows, columns = np.nonzero(shirt)
            assert abs(columns.mean() - 99.5) < 3
            # The upper body is 0.8 to 1.45 m high, the eye 1.1 m; nothing of it is above 1.5 m.
            assert rows.min() > 79.5 - geometry.focal_length_px * 0.4


def test_drive_stops_at_a_person_and_counts_one_touch() -> None:
    now = [0.0]
    standing = replace(ANNA, from_s=1000.0)
    drive = SimulatedDrive(replace(ROOM, people=(standing,)), lambda: now[0])
    for _ in range(60):
        drive.command(0.5, 0.0, 0.3)
        now[0] += 0.1
        drive.read()
    # Between the legs, whose middles are 0.18 m apart, the robot comes a little nearer than their front.
    assert 0.2 < 2.0 - drive.ground_truth().pose.x_m < 0.27
    assert (drive.touches, drive.collisions) == (1, 1)
    assert drive.world_state().touches == 1
    np.testing.assert_allclose(drive.people[0, :2], (2.0, 5.0))


def test_wall_is_no_touch() -> None:
    now = [0.0]
    drive = SimulatedDrive(replace(ROOM, start=Pose(9.0, 2.0, 0.0)), lambda: now[0])
    for _ in range(40):
        drive.command(0.5, 0.0, 0.3)
        now[0] += 0.1
        drive.read()
    assert (drive.touches, drive.collisions) == (0, 1)


@pytest.mark.parametrize(
    ("person", "message"),
    [
        ("{name: Eve, way: [[1, 1, 0], [3, 3, 0]], walks: backwards}", "walks must be one of"),
        ("{name: Eve, way: [[1, 1, 0]]}", "at least two points"),
        ("{name: Eve, way: [[1, 1, 0], [9, 1, 0]]}", r"no room for a person at \(4\.[0-9]+, 1\.00\)"),
        ("{name: Eve, way: [[1, 1, 0], [3, 3, 0]], shirt: [300, 0, 0]}", "each from 0 to 255"),
        ("{name: Eve, way: [[1, 1, 0], [3, 3, 0]], speed_m_per_s: 0}", "greater than 0"),
        ("{name: Eve, way: [[1, 1, 0], [3, 3, 0]], hat: red}", "unknown key 'hat'"),
    ],
)
def test_wrong_people_in_an_arena_file_are_errors_with_a_line(
    tmp_path: Path, person: str, message: str
) -> None:
    file = tmp_path / "arena.yaml"
    rows = ["#" * 20, *["#" + "." * 18 + "#"] * 10, "#" * 20]
    rows[5] = "#R" + "." * 17 + "#"
    drawing = "".join(f"  {row}\n" for row in rows)
    file.write_text(
        f"cell_m: 0.5\ndrawing: |\n{drawing}boxes: [[4.2, 0.5, 4.4, 2.0]]\npeople:\n  - {person}\n"
    )
    with pytest.raises(ArenaError, match=rf"arena\.yaml:\d+: .*{message}"):
        read_arena(file)


def test_people_of_the_apartment_walk_and_cross_the_first_one_twice_a_minute() -> None:
    arena = read_arena(ARENAS / "apartment.yaml")
    people = walked(WalkingPeople(arena.people), 12.0)
    assert [person.name for person in arena.people] == ["Anna", "Ben", "Clara", "David"]
    starts = {"Ben": 0, "Clara": 0}
    for tick in range(240, 20 * 132):
        before = people.states[:]
        people.walk_until(tick / 20, FAR_AWAY)
        for index, name in ((1, "Ben"), (2, "Clara")):
            starts[name] += before[index].stride == 0.0 < people.states[index].stride
    assert sum(starts.values()) >= 4 and min(starts.values()) >= 1


def portrait(folder: Path, name: str, colour: tuple[int, int, int]) -> None:
    Image.new("RGB", (20, 27), colour).save(folder / name)


def test_camera_shows_a_persons_pictures_in_turns_where_the_head_is(tmp_path: Path) -> None:
    portrait(tmp_path, "Anna_1.png", (0, 0, 255))
    portrait(tmp_path, "Anna_2.png", (0, 255, 0))
    portrait(tmp_path, "Ben.png", (255, 0, 255))
    heads = read_heads(tmp_path, ["Anna", "Clara"])
    assert {name: len(pictures) for name, pictures in heads.items()} == {"Anna": 2}
    camera = SimulatedCamera(ROOM, CameraGeometry(320, 240, 1.2, (0.0, 0.0, 1.1)), noise=0.0)
    camera.heads, camera.people = heads, np.array([[3.0, 5.0, 0.0, 0.0, 0.0]])
    camera.look(0.0, -math.atan2(1.58 - 1.1, 2.0))
    for stamp_s, colour in ((0.0, [0, 0, 255]), (PICTURE_S, [0, 255, 0]), (2 * PICTURE_S, [0, 0, 255])):
        camera.place(Pose(1.0, 5.0, 0.0), stamp_s)
        assert camera.capture().pixels[120, 160].tolist() == colour


def test_folder_without_pictures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FacesError, match="no such folder"):
        read_heads(tmp_path / "none", ["Anna"])
    (tmp_path / "Anna.png").write_text("no picture")
    with pytest.raises(FacesError, match=r"Anna\.png: cannot be read as a picture"):
        read_heads(tmp_path, ["Anna"])
