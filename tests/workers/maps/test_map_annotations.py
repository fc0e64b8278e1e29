"""Drawings of people on a map: checked, changed, taken back, saved and drawn into the map's cells."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_robots.workers.maps.map_annotations import (
    MAX_AREAS,
    MAX_CORNERS,
    MAX_PLACES,
    MAX_UNDO,
    AnnotatedMap,
    AnnotationError,
    AnnotationFileError,
    Annotations,
    annotations_path,
    forbid,
    read_annotations,
)
from robbie_robots.workers.maps.navigation_grid import FORBIDDEN, NavigationGrid

SQUARE = [(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)]
KITCHEN = (3.0, 0.5, 1.5)


def drawn() -> Annotations:
    return Annotations().changed((), [("stairs", SQUARE)], [("kitchen", KITCHEN)])


def test_areas_and_places_are_added_replaced_and_removed_by_name() -> None:
    first = drawn()
    second = first.changed(["stairs"], [("", SQUARE), ("", SQUARE)], [("kitchen", (0.0, 0.0, 0.0))])
    assert list(second.no_go) == ["no-go 1", "no-go 2"]
    assert second.places == {"kitchen": (0.0, 0.0, 0.0)}
    assert first == drawn()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ((["door"],), "no area and no place is called 'door'"),
        (([], [("hole", SQUARE[:2])]), "'hole' must have 3 to 64 corners"),
        (([], [("hole", SQUARE * 17)]), "'hole' must have 3 to 64 corners"),
        (([], [("hole", [SQUARE[0]] * 4)]), "'hole' must have 3 different corners"),
        (([], [("hole", [*SQUARE, (float("nan"), 0.0)])]), "expected x and y (m) within 10000 m, not (nan"),
        (([], [("hole", [*SQUARE, (2e4, 0.0)])]), "'hole': expected x and y (m) within 10000 m"),
        (([], [("kitchen", SQUARE)]), "a place is called 'kitchen' already"),
        (([], [], [("stairs", KITCHEN)]), "an area is called 'stairs' already"),
        (([], [], [("", KITCHEN)]), "a name has 1 to 64 printable characters, unlike ''"),
        (([], [], [("a\x1b[2J", KITCHEN)]), "a name has 1 to 64 printable characters"),
        (([], [], [("n" * 65, KITCHEN)]), "a name has 1 to 64 printable characters"),
        (([], [], [("bath", (0.0, True, 0.0))]), "'bath': expected x, y (m) and heading (rad)"),
        (([], [(f"{number}", SQUARE) for number in range(MAX_AREAS)]), "a map holds at most 64 no-go areas"),
        (([], [], [(f"{number}", KITCHEN) for number in range(MAX_PLACES)]), "at most 128 places"),
    ],
)
def test_invalid_change_is_refused_with_what_was_expected(change: tuple[Any, ...], reason: str) -> None:
    assert len(SQUARE * 17) > MAX_CORNERS
    with pytest.raises(AnnotationError) as refused:
        drawn().changed(*change)
    assert reason in str(refused.value)


def test_changes_are_taken_back_one_after_another_and_their_number_is_bounded() -> None:
    changed = AnnotatedMap()
    for number in range(MAX_UNDO + 5):
        changed = changed.replaced(Annotations(places={"robot": (float(number), 0.0, 0.0)}))
    changed = AnnotatedMap.from_state(changed.state())
    for _ in range(MAX_UNDO):
        changed = changed.undone()
    assert changed.now.places == {"robot": (4.0, 0.0, 0.0)}
    assert changed.revision == 2 * MAX_UNDO + 5
    with pytest.raises(AnnotationError, match="there is no change to take back"):
        changed.undone()


def test_saved_annotations_are_read_again(tmp_path: Path) -> None:
    path = annotations_path(tmp_path / "arena.yaml")
    assert path.name == "arena.annotations.yaml"
    assert read_annotations(path).now == Annotations()
    path.write_text(AnnotatedMap(drawn(), 7).as_yaml(), encoding="utf-8")
    again = read_annotations(path)
    assert (again.now, again.revision, again.can_undo) == (drawn(), 7, False)


@pytest.mark.parametrize(
    "name", ["1e3", "0o7", "no", "1:30", "2026-13-45", "<<", "=", "~", "a: b", "[x", "né"]
)
def test_any_name_is_read_again_as_it_was(tmp_path: Path, name: str) -> None:
    path = tmp_path / "arena.annotations.yaml"
    named = Annotations().changed((), [(name, SQUARE)], [(f"{name} 2", KITCHEN)])
    path.write_text(AnnotatedMap(named).as_yaml(), encoding="utf-8")
    assert read_annotations(path).now == named


def test_numbers_mean_what_they_mean_in_profiles(tmp_path: Path) -> None:
    path = tmp_path / "arena.annotations.yaml"
    path.write_text("places: {bath: [010, 1e-3, 0]}")
    assert read_annotations(path).now.places["bath"] == (10.0, 0.001, 0.0)


def test_pipe_is_refused_instead_of_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "arena.annotations.yaml"
    os.mkfifo(path)
    with pytest.raises(AnnotationFileError, match=r"FIFO|Invalid argument"):
        read_annotations(path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", ":1: YAML: while parsing"),
        (
            "no_go: {a: [[0, 0], [1, 0], [1, 1]],\n a: [[5, 5], [6, 5], [6, 6]]}",
            ":2: YAML: key 'a' is set twice",
        ),
        ("places: {bath: [1, 2, 90]}", "'bath': a heading is at most 2 pi, not 90; is it in degrees?"),
        ("places: {bath: [1:30, 2, 0]}", "'bath': expected x, y (m)"),
        ("places: {bath: [!!int '', 2, 0]}", "'' is not of type int"),
        ("revision: true", "revision must be a number of changes"),
        ("[" * 500, "nested deeper"),
        ("- 1", "expected the keys revision, no_go and places"),
        ("areas: {}", "expected the keys revision, no_go and places"),
        ("revision: -1", "revision must be a number of changes"),
        ("no_go: [1]", "no_go and places must map names to coordinates"),
        ("no_go: {'': [[0, 0], [1, 0], [1, 1]]}", "an area has no name"),
        ("no_go: {hole: 5}", "'hole' must have 3 to 64 corners"),
        ("places: {bath: [1, 2]}", "'bath': expected x, y (m) and heading (rad)"),
        ("places: {7: [1, 2, 3]}", "expected a str as key; got '7'; quote it"),
    ],
)
def test_invalid_file_is_named_with_what_was_expected(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "arena.annotations.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(AnnotationFileError) as refused:
        read_annotations(path)
    assert str(refused.value).startswith(f"{path}:")
    assert reason in str(refused.value)


def test_cells_of_an_area_are_forbidden_whatever_its_shape_and_the_map_is_not_changed() -> None:
    cells = np.zeros((40, 60), np.int8)
    cells[0, :] = -1
    ell = [(0.5, 0.0), (2.5, 0.0), (2.5, 0.5), (1.0, 0.5), (1.0, 1.5), (0.5, 1.5)]
    beyond = [(2.9, 1.9), (50.0, 1.9), (50.0, 50.0)]
    found = forbid(cells, 0.05, (0.0, 0.0), [ell, beyond])
    grid = NavigationGrid(found, 0.05, (0.0, 0.0), 0.1)
    assert [grid.forbids(at) for at in ((2.0, 0.25), (0.75, 1.2), (0.75, 0.01), (2.97, 1.95))] == [True] * 4
    assert [grid.forbids(at) for at in ((2.0, 1.0), (0.3, 0.3), (9.0, 9.0))] == [False] * 3
    assert not grid.drivable[grid.cell((2.0, 0.6))]
    assert grid.drivable[grid.cell((2.0, 1.0))]
    assert not (cells == FORBIDDEN).any()


def test_robot_that_leaves_a_narrow_place_may_not_leave_through_a_no_go_area() -> None:
    cells = np.zeros((40, 40), np.int8)
    strip = [(1.0, 0.0), (1.1, 0.0), (1.1, 2.0), (1.0, 2.0)]
    grid = NavigationGrid(forbid(cells, 0.05, (0.0, 0.0), [strip]), 0.05, (0.0, 0.0), 0.2)
    around = grid.around_robot((0.95, 1.0), 0.2, 0.2)
    assert not around.drivable[around.cell((1.05, 1.0))]
