"""Arenas are read from YAML, and errors are reported with their line."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import ArenaVictim, HazardSign, SignKind, VictimKind, WallSpot
from robbie_robots.hw.simulation.arena_file import ArenaError, read_arena
from tests._support.places import ARENAS

DEMO = ARENAS / "demo.yaml"

ROOM = """\
cell_m: 0.5
drawing: |
  ######
  #.o..#
  #R...#
  ######
"""


def arena(tmp_path: Path, text: str) -> Arena:
    path = tmp_path / "room.yaml"
    path.write_text(text)
    return read_arena(path)


def test_drawing_becomes_walls_obstacles_and_a_start(tmp_path: Path) -> None:
    room = arena(tmp_path, ROOM)
    assert (room.width_m, room.height_m) == (3.0, 2.0)
    assert room.start == Pose(0.75, 0.75, 0.0)
    np.testing.assert_allclose(room.circles, [[1.25, 1.25, 0.25]])
    # Four sides outside and four inside, each one piece.
    assert len(room.segments) == 8
    assert {0.0, 0.5, 1.5, 2.0} == set(room.segments[:, 1]) | set(room.segments[:, 3])


def test_shapes_in_metres_join_the_drawing(tmp_path: Path) -> None:
    shapes = "segments: [[1.0, 0.5, 1.0, 1.0]]\nboxes: [[2.0, 0.6, 2.2, 0.9]]\ncircles: [[1.5, 0.8, 0.1]]\n"
    room = arena(tmp_path, ROOM + shapes + "start_heading_rad: 1.5\n")
    assert len(room.segments) == 8 + 1 + 4
    assert len(room.circles) == 2
    assert room.start.heading_rad == 1.5


def test_tables_stop_robots_and_objects_stand_on_them(tmp_path: Path) -> None:
    text = (
        "tables: [{name: shelf, box: [1.5, 0.6, 2.2, 0.9], height_m: 0.4}]\n"
        "objects: [{name: soup, can: [0.06, 0.1], x_m: 1.6, y_m: 0.7},"
        " {name: tea, box: [0.06, 0.04, 0.12], x_m: 2.0, y_m: 0.8, yaw_rad: 0.3, print: 7}]\n"
    )
    room = arena(tmp_path, ROOM + text)
    assert len(room.segments) == 8 + 4
    assert [(table.name, table.height_m) for table in room.tables] == [("shelf", 0.4)]
    soup, tea = room.objects
    assert (soup.size_m, soup.is_round, soup.base_m) == ((0.06, 0.06, 0.1), True, 0.4)
    assert (tea.size_m, tea.is_round, tea.yaw_rad) == ((0.06, 0.04, 0.12), False, 0.3)
    assert (soup.print_seed, tea.print_seed) == (None, 7)
    for wrong, problem in (
        (text.replace("x_m: 1.6", "x_m: 1.3"), "no table is below the object at"),
        (text.replace("name: tea", "name: soup"), "another object has the name 'soup' already"),
        (text.replace("can: [0.06, 0.1], ", ""), "an object is either a box or a can"),
        (text.replace("[0.06, 0.1]", "[0.06, -0.1]"), "the size of an object must be positive"),
        (text.replace("print: 7", "print: 7.5"), "print must be a whole number from 0, not 7.5"),
        (text.replace("[1.5, 0.6, 2.2, 0.9]", "[0.6, 0.6, 0.9, 0.9]"), "lies within a box or table"),
    ):
        with pytest.raises(ArenaError, match=problem):
            arena(tmp_path, ROOM + wrong)


def test_space_and_dot_both_mean_free(tmp_path: Path) -> None:
    spaced = arena(tmp_path, ROOM.replace("R...", "R  ."))
    np.testing.assert_array_equal(spaced.segments, arena(tmp_path, ROOM).segments)


def test_every_room_of_the_demo_arena_has_a_doorway_of_90_cm() -> None:
    demo = read_arena(DEMO)
    y, x = np.mgrid[0 : demo.height_m : 0.05, 0 : demo.width_m : 0.05]
    passable, _ = ndimage.label(demo.clearance_m(np.stack([x, y], axis=-1)) > 0.45)
    at = {
        (a, b): passable[round(b / 0.05), round(a / 0.05)] for a, b in [(2, 4.5), (6, 4.5), (2, 1), (5.5, 1)]
    }
    assert set(at.values()) == {passable[round(demo.start.y_m / 0.05), round(demo.start.x_m / 0.05)]} != {0}


def test_victims_signs_and_temporary_obstacles_are_read(tmp_path: Path) -> None:
    room = arena(
        tmp_path,
        ROOM
        + """\
wall_height_m: 0.8
victims:
  - {tag: 7, x_m: 0.5, y_m: 0.75, facing_rad: 0.0, kind: moving}
  - {tag: 8, x_m: 2.0, y_m: 0.5, height_m: 0.4, facing_rad: 1.5708}
signs:
  - {kind: toxic, x_m: 2.5, y_m: 1.0, height_m: 0.5, facing_rad: 3.1416}
appearing:
  - {circle: [1.5, 0.75, 0.2], from_s: 5}
  - {box: [1.5, 1.0, 1.7, 1.5], from_s: 5, until_s: 9}
""",
    )
    assert room.wall_height_m == 0.8
    assert room.victims == (
        ArenaVictim(7, VictimKind.MOVING, WallSpot(0.5, 0.75, 0.35, 0.0)),
        ArenaVictim(8, VictimKind.STILL, WallSpot(2.0, 0.5, 0.4, 1.5708)),
    )
    assert room.signs == (HazardSign(SignKind.TOXIC, WallSpot(2.5, 1.0, 0.5, 3.1416)),)
    assert [obstacle.until_s for obstacle in room.appearing] == [math.inf, 9.0]
    assert len(room.with_obstacles([1]).segments) == len(room.segments) + 4
    assert len(room.with_obstacles([0]).circles) == len(room.circles) + 1


VICTIM = "victims:\n  - {tag: 7, x_m: 0.5, y_m: 0.75, facing_rad: 0.0}\n"


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        (ROOM.replace("#R...#", "#R.x.#"), 5, "unknown character 'x' in column 4"),
        (ROOM.replace("#R...#", "#R..#"), 5, "this line has 5 characters, the first line has 6"),
        (ROOM.replace("#R...#", "#R...."), 5, "not closed"),
        (ROOM.replace("R", "."), 3, "no R"),
        (ROOM.replace("o", "R"), 5, "second R"),
        (ROOM.replace("0.5", "big"), 1, "expected a number"),
        (ROOM.replace("0.5", "-1"), 1, "greater than 0"),
        (ROOM.replace("0.5", ".nan"), 1, "finite"),
        (ROOM + "walls: []\n", 7, "unknown key 'walls'"),
        (ROOM + "cell_m: 1\n", 7, "twice"),
        (ROOM + "segments: 3\n", 7, "must be a list"),
        (ROOM + "circles:\n  - [1, 1, 0.1]\n  - [1, 2]\n", 9, "list of 3 numbers"),
        (ROOM + "circles: [[1, 1, 0]]\n", 7, "radius"),
        (ROOM + "boxes: [[0.6, 0.6, 1, 1]]\n", 7, "start (0.75, 0.75) lies within a box"),
        (ROOM + "circles: [[0.8, 0.8, 0.2]]\n", 7, "lies within a circle"),
        (ROOM.replace("cell_m: 0.5\n", ""), 1, "'cell_m' is missing"),
        ("cell_m: 0.5\ndrawing: RR\n", 2, "must be a block"),
        ("cell_m: 0.5\ndrawing: |\n", 3, "empty"),
        (ROOM + "wall_height_m: 0\n", 7, "wall_height_m must be greater than 0"),
        (ROOM + VICTIM.replace("7", "50"), 8, "tag must be a whole number from 0 to 49"),
        (ROOM + VICTIM.replace("7", "1.5"), 8, "tag must be a whole number"),
        (ROOM + VICTIM + VICTIM[9:], 9, "another victim has the tag 7"),
        (ROOM + VICTIM.replace("tag: 7, ", ""), 8, "'tag' is missing"),
        (ROOM + VICTIM.replace("}", ", kind: dead}"), 8, "kind must be one of still, moving, cold"),
        (ROOM + VICTIM.replace("0.5,", "1.0,"), 8, "not on a wall: the nearest wall is 0.25 m"),
        (ROOM + VICTIM.replace("0.0}", "3.14}"), 8, "facing_rad must point out of the wall"),
        (ROOM + VICTIM.replace("0.0}", "1.57}"), 8, "facing_rad must point out of the wall"),
        (ROOM + "victims: [3]\n", 7, "a victim is a map"),
        (ROOM + "signs:\n- {kind: big}\n", 8, "kind must be one of explosive, flammable_gas"),
        (ROOM + "appearing: [{from_s: 3}]\n", 7, "either a circle or a box"),
        (ROOM + "appearing: [{circle: [1, 1, 0], from_s: 3}]\n", 7, "radius"),
        (ROOM + "appearing: [{circle: [1, 1, 0.1]}]\n", 7, "'from_s' is missing"),
        (ROOM + "appearing: [{box: [1, 1, 2, 2], from_s: 3, until_s: 3}]\n", 7, "later than from_s"),
        ("cell_m: [0.5\n", 2, "YAML: while parsing a flow sequence"),
        (ROOM.replace("0.5", "1:30"), 1, "expected a number"),
        (ROOM.replace("0.5", "!!int abc"), 1, "not of type int"),
        (ROOM.replace("0.5", "9" * 5000), 1, "does not fit into 64 bits"),
        ("[" * 500, 1, "nested deeper"),
        (ROOM.replace("cell_m", "? [a]\n: 1\ncell_m"), 1, "expected a str as key"),
        ("- 1\n", 1, "an arena is a map"),
        ("", 1, "an arena is a map"),
    ],
)
def test_error_names_file_and_line(tmp_path: Path, text: str, line: int, what: str) -> None:
    with pytest.raises(ArenaError) as caught:
        arena(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'room.yaml'}:{line}: ")
    assert what in message


@pytest.mark.parametrize(("text", "cell_m"), [("0100", 100.0), ("1e-1", 0.1)])
def test_numbers_are_those_of_profiles(tmp_path: Path, text: str, cell_m: float) -> None:
    assert arena(tmp_path, ROOM.replace("0.5", text)).start.x_m == pytest.approx(1.5 * cell_m)


def test_missing_file_is_an_error_of_the_arena(tmp_path: Path) -> None:
    with pytest.raises(ArenaError, match=r"none\.yaml:1: cannot be read"):
        read_arena(tmp_path / "none.yaml")
