"""Arenas are read from YAML, and what is wrong with a file is told with its line."""

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from hw.arena_file import ArenaError, read_arena
from hw.pose import Pose

DEMO = Path(__file__).parents[2] / "hw" / "arenas" / "demo.yaml"

ROOM = """\
cell_m: 0.5
drawing: |
  ######
  #.o..#
  #R...#
  ######
"""


def arena(tmp_path: Path, text: str):
    path = tmp_path / "room.yaml"
    path.write_text(text)
    return read_arena(path)


def test_drawing_becomes_walls_obstacles_and_a_start(tmp_path):
    room = arena(tmp_path, ROOM)
    assert (room.width_m, room.height_m) == (3.0, 2.0)
    assert room.start == Pose(0.75, 0.75, 0.0)
    np.testing.assert_allclose(room.circles, [[1.25, 1.25, 0.25]])
    # Four sides outside and four inside, each one piece.
    assert len(room.segments) == 8
    assert {0.0, 0.5, 1.5, 2.0} == set(room.segments[:, 1]) | set(room.segments[:, 3])


def test_shapes_in_metres_join_the_drawing(tmp_path):
    shapes = "segments: [[1.0, 0.5, 1.0, 1.0]]\nboxes: [[2.0, 0.6, 2.2, 0.9]]\ncircles: [[1.5, 0.8, 0.1]]\n"
    room = arena(tmp_path, ROOM + shapes + "start_heading_rad: 1.5\n")
    assert len(room.segments) == 8 + 1 + 4
    assert len(room.circles) == 2
    assert room.start.heading_rad == 1.5


def test_space_and_dot_are_both_free(tmp_path):
    spaced = arena(tmp_path, ROOM.replace("R...", "R  ."))
    np.testing.assert_array_equal(spaced.segments, arena(tmp_path, ROOM).segments)


def test_every_room_of_the_demo_arena_has_a_doorway_of_90_cm():
    demo = read_arena(DEMO)
    y, x = np.mgrid[0 : demo.height_m : 0.05, 0 : demo.width_m : 0.05]
    passable, _ = ndimage.label(demo.clearance_m(np.stack([x, y], axis=-1)) > 0.45)
    at = {
        (a, b): passable[round(b / 0.05), round(a / 0.05)] for a, b in [(2, 4.5), (6, 4.5), (2, 1), (5.5, 1)]
    }
    assert set(at.values()) == {passable[round(demo.start.y_m / 0.05), round(demo.start.x_m / 0.05)]} != {0}


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
        ("cell_m: [0.5\n", 2, "not YAML"),
        ("- 1\n", 1, "an arena is a map"),
        ("", 1, "an arena is a map"),
    ],
)
def test_error_names_file_and_line(tmp_path, text, line, what):
    with pytest.raises(ArenaError) as caught:
        arena(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'room.yaml'}:{line}: ")
    assert what in message
