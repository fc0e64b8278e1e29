"""The picture shows free, occupied and unknown, and the paths where they are."""

import io

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from robbie_robots.workers.maps.map_picture import ESTIMATED, TRUE, UNKNOWN, map_picture


def picture(cells: NDArray[np.int8], **paths: ArrayLike) -> NDArray[np.uint8]:
    with Image.open(io.BytesIO(map_picture(cells, (0.0, 0.0), 0.1, **paths))) as image:
        return np.array(image.convert("RGB"))


@pytest.fixture
def cells() -> NDArray[np.int8]:
    """A map of 6 m x 4 m: free, a wall along the top, the right third unknown."""
    cells = np.zeros((40, 60), np.int8)
    cells[35:] = 100
    cells[:, 40:] = -1
    return cells


def test_free_is_white_occupied_black_unknown_grey(cells: NDArray[np.int8]) -> None:
    image = picture(cells)
    px_per_m = image.shape[1] / 5.0  # 4 m are known, and 0.5 m on each side
    shade = {name: image[int(y * px_per_m), int(x * px_per_m)].tolist() for name, x, y in
             (("wall", 2.0, 0.75), ("free", 2.0, 3.0), ("unknown", 4.8, 2.0))}  # fmt: skip
    assert shade == {"wall": [0, 0, 0], "free": [255] * 3, "unknown": [UNKNOWN] * 3}


def test_paths_are_drawn_in_their_colours_and_the_estimate_on_top(cells: NDArray[np.int8]) -> None:
    image = picture(cells, estimated_path=[(1, 1), (1, 3)], true_path=[(0.5, 2), (3, 2)])
    px_per_m = image.shape[1] / 5.0
    row = image[int((0.5 + 4.0 - 2.0) * px_per_m)]
    assert tuple(row[int(1.5 * px_per_m)]) == ESTIMATED
    assert tuple(row[int(2.5 * px_per_m)]) == TRUE


def test_empty_map_can_be_drawn() -> None:
    assert picture(np.zeros((0, 0), np.int8)).shape[2] == 3
    assert picture(np.full((5, 5), -1, np.int8), estimated_path=[(0, 0)]).shape[2] == 3


def test_thin_wall_of_a_large_map_stays_visible() -> None:
    cells = np.zeros((200, 6000), np.int8)
    cells[100] = 100
    image = picture(cells)
    assert image[:-40, image.shape[1] // 2].min() < 160
    assert max(image.shape) < 2600
