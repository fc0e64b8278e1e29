"""Maps as files in the format of ROS's map_server."""

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robbie_robots.workers.maps.map_file import MapFileError, describe_map, read_map, write_map

CELLS = np.array([[0, 10, 100], [-1, 49, 50]], dtype=np.int8)


def test_written_map_is_read_back_unchanged(tmp_path: Path) -> None:
    write_map(tmp_path / "map.yaml", CELLS, 0.05, (-1.5, 2.0))
    read = read_map(tmp_path / "map.yaml")
    assert read.cells.tolist() == [[0, 0, 100], [-1, 0, 100]]
    assert read.resolution_m == 0.05
    assert read.corner_xy_m.tolist() == [-1.5, 2.0]


def test_image_has_its_uppermost_row_first(tmp_path: Path) -> None:
    write_map(tmp_path / "map.yaml", CELLS, 0.05, (0, 0))
    assert np.asarray(Image.open(tmp_path / "map.pgm"))[0].tolist() == [205, 254, 0]


def test_empty_map_is_written_as_one_unknown_cell(tmp_path: Path) -> None:
    write_map(tmp_path / "map.yaml", np.zeros((0, 0), dtype=np.int8), 0.05, (0, 0))
    assert read_map(tmp_path / "map.yaml").cells.tolist() == [[-1]]


def test_negated_map_is_read(tmp_path: Path) -> None:
    write_map(tmp_path / "map.yaml", CELLS, 0.05, (0, 0))
    text = (tmp_path / "map.yaml").read_text()
    (tmp_path / "map.yaml").write_text(text.replace("negate: 0", "negate: 1"))
    assert read_map(tmp_path / "map.yaml").cells[0].tolist() == [100, 100, 0]


def changed(folder: Path, old: str, new: str) -> Path:
    """Write a map whose YAML file differs in one place."""
    path = folder / "map.yaml"
    write_map(path, CELLS, 0.05, (0, 0))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("resolution: 0.05", "resolution: fine", "resolution must be a number"),
        ("resolution: 0.05", "resolution: -1", "must be a number from 0.0001"),
        ("resolution: 0.05", "resolution: 1:30", "must be a number"),
        ("resolution: 0.05", "resolution: .inf", "must be a number"),
        ("resolution: 0.05", "resolution: [1]", "one value"),
        ("resolution: 0.05", "Resolution: 0.05", "resolution missing"),
        ("resolution: 0.05", "resolution: 0.05\nresolution: 0.1", "twice"),
        ("image: map.pgm", "image: gone.pgm", "no such file"),
        ("image: map.pgm", "image: ''", "must name a file"),
        ("image: map.pgm", "image: ..", "no file"),
        ("image: map.pgm", "image: map.yaml", "none of PNG"),
        ("image: map.pgm", f"image: {'x' * 300}", "cannot be read"),
        ("image: map.pgm", 'image: "a\\0b"', "no such file"),
        ("image: map.pgm", "image: [", "cannot be read as YAML"),
        ("image: map.pgm", "image: " + "[" * 20_000, "cannot be read as YAML"),
        ("- 0.0\n- 0.0\n- 0.0", "- 0.0", "three numbers"),
        ("- 0.0\n- 0.0\n- 0.0", "- 0.0\n- 0.0\n- [0.0]", "three numbers"),
        ("- 0.0\n- 0.0\n- 0.0", "- 0.0\n- 0.0\n- .nan", "origin must be a number"),
        ("- 0.0\n- 0.0\n- 0.0", "- 0.0\n- 0.0\n- 90", "at most 2 pi, not 90; is it in degrees?"),
        ("mode: trinary", "mode: grey", "mode must be trinary, scale, raw"),
        ("mode: trinary", "mode:", "mode must be"),
        ("negate: 0", "negate: maybe", "negate must be 0 or 1"),
        ("negate: 0", "", "negate missing"),
        ("occupied_thresh: 0.65", "occupied_thresh: 65", "in percent"),
        ("free_thresh: 0.196", "free_thresh: -0.1", "from 0 to 1"),
        ("free_thresh: 0.196", "free_thresh: 0.65", "swapped"),
        ("free_thresh: 0.196", "free_thresh: 0.7", "swapped"),
    ],
)
def test_errors_of_a_map_file_are_described(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    path = changed(tmp_path, old, new)
    with pytest.raises(MapFileError, match=complaint) as caught:
        read_map(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 1_000


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("mode: trinary\n", ""),
        ("mode: trinary", "mode: Trinary"),
        ("resolution: 0.05", "resolution: 5e-2"),
        ("resolution: 0.05", "resolution: '+.05'"),
        ("resolution: 0.05", "resolution: !!str 0.05"),
        ("negate: 0", "negate: no"),
        ("negate: 0", "negate: False"),
        ("occupied_thresh: 0.65", "occupied_thresh: 1"),
        ("image: map.pgm", "image: ./map.pgm\nfree: &a [*a, *a]\nfloor: 2"),
        ("image: map.pgm", "---\nimage: map.pgm  # the hall"),
        ("- 0.0\n- 0.0\n- 0.0", "- 0.0\n- 0.0\n- 6.283185307179586"),
    ],
)
def test_notations_of_yaml_cpp_are_read(tmp_path: Path, old: str, new: str) -> None:
    read = read_map(changed(tmp_path, old, new))
    assert read.cells.tolist() == [[0, 0, 100], [-1, 0, 100]]
    assert (read.resolution_m, read.corner_xy_m.tolist()) == (0.05, [0, 0])


def test_image_may_be_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in (tmp_path / "home" / "map.pgm", "~/map.pgm"):
        path = changed(tmp_path, "image: map.pgm", f"image: {name}")
        (tmp_path / "map.pgm").rename(tmp_path / "home" / "map.pgm")
        assert read_map(path).cells.shape == (2, 3)


def test_missing_file_and_unrelated_yaml_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapFileError):
        read_map(tmp_path / "none.yaml")
    (tmp_path / "list.yaml").write_text("[1, 2]")
    with pytest.raises(MapFileError, match="expected the keys"):
        read_map(tmp_path / "list.yaml")
    write_map(tmp_path / "map.yaml", np.zeros((500, 500), np.int8), 0.05, (0, 0))
    with pytest.raises(MapFileError, match="give the YAML file, not its image"):
        read_map(tmp_path / "map.pgm")


@pytest.mark.parametrize("read", [read_map, describe_map])
def test_pipes_do_not_block(tmp_path: Path, read: Callable[[Path], object]) -> None:
    path = changed(tmp_path, "image: map.pgm", "image: pipe")
    os.mkfifo(tmp_path / "pipe")
    for place in (path, tmp_path / "pipe"):
        with pytest.raises(MapFileError, match="no file"):
            read(place)


def test_turned_map_is_read_along_the_axes(tmp_path: Path) -> None:
    cells = np.zeros((2, 3), np.int8)
    cells[0, 2] = 100
    write_map(tmp_path / "map.yaml", cells, 0.5, (10.0, 20.0))
    text = (tmp_path / "map.yaml").read_text().replace("- 20.0\n- 0.0", f"- 20.0\n- {math.pi / 2}")
    (tmp_path / "map.yaml").write_text(text)
    read = read_map(tmp_path / "map.yaml")
    assert read.cells.tolist() == [[0, 0], [0, 0], [0, 100]]
    assert read.corner_xy_m == pytest.approx([9.0, 20.0])


def test_narrow_map_that_its_turn_makes_huge_is_refused(tmp_path: Path) -> None:
    write_map(tmp_path / "map.yaml", np.zeros((1, 90_000), np.int8), 0.5, (0, 0))
    text = (tmp_path / "map.yaml").read_text().replace("- 0.0\n- 0.0\n- 0.0", "- 0.0\n- 0.0\n- 0.8")
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(MapFileError, match="turn its image instead"):
        read_map(tmp_path / "map.yaml")


def test_map_is_described(tmp_path: Path) -> None:
    path = changed(tmp_path, "image: map.pgm", "image: map.png\nfloor: 2")
    Image.fromarray(np.array([[[0, 255], [254, 255], [205, 255], [0, 9]]], np.uint8), "LA").save(
        tmp_path / "map.png"
    )
    assert describe_map(path) == {
        "image": "map.png (PNG, grey and alpha, 8 bits)",
        "size": "4 x 1 cells, 0.2 m x 0.05 m",
        "resolution": "0.05 m",
        "origin": "x 0 m, y 0 m, yaw 0°",
        "mode": "trinary",
        "thresholds": "occupied from 0.65, free up to 0.196",
        "cells": "1 free, 1 occupied, 2 unknown",
        "left out": "1 transparent pixels, read as unknown; unknown keys: floor",
    }
    with pytest.raises(MapFileError):
        describe_map(tmp_path / "none.yaml")
