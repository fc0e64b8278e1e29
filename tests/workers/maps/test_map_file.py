"""Maps as files in the format of ROS's map_server."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robbie_robots.workers.maps.map_file import MapFileError, read_map, write_map

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


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("resolution: 0.05", "resolution: fine", "resolution must be a finite number"),
        ("resolution: 0.05", "resolution: -1", "greater than 0"),
        ("image: map.pgm", "image: gone.pgm", "cannot be read"),
        ("- 0.0\n- 0.0\n- 0.0", "- 0.0", "three numbers"),
        ("- 0.0\n- 0.0\n- 0.0", "- 0.0\n- 0.0\n- 0.5", "rotated map"),
        ("image: map.pgm", "image: [", "cannot be read as YAML"),
    ],
)
def test_errors_of_a_map_file_are_described(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    path = tmp_path / "map.yaml"
    write_map(path, CELLS, 0.05, (0, 0))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(MapFileError, match=complaint) as caught:
        read_map(path)
    assert str(path) in str(caught.value)


def test_missing_file_and_unrelated_yaml_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MapFileError):
        read_map(tmp_path / "none.yaml")
    (tmp_path / "list.yaml").write_text("[1, 2]")
    with pytest.raises(MapFileError, match="expected the keys"):
        read_map(tmp_path / "list.yaml")
