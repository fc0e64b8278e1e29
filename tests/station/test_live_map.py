"""The map's tiles together equal the map, and only changed tiles are drawn again."""

import io
import json

import numpy as np
import pytest
from PIL import Image

from robbie_mp.messages import MapMetaData, OccupancyGrid, Point, Pose, Quaternion
from robbie_mp.station.live.map import MAX_PIXELS, TILE, MapTiles

CELL_M = 0.1


def map_of(cells: np.ndarray, x_m: float = 0.0, y_m: float = 0.0) -> OccupancyGrid:
    corner = Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion(w=1.0))
    info = MapMetaData(resolution=CELL_M, width=cells.shape[1], height=cells.shape[0], origin=corner)
    return OccupancyGrid(info=info, data=np.ascontiguousarray(cells, np.int8).ravel())


def some_cells(rows: int, columns: int) -> np.ndarray:
    return np.random.default_rng(7).choice(np.array([-1, 0, 50, 100], np.int8), (rows, columns))


def put_together(parts: dict[str, bytes]) -> np.ndarray:
    """What the page's script makes of the tiles: (rows, columns, 4), the greatest y first."""
    place = json.loads(parts["place"])
    picture = Image.new("RGBA", (place["columns"], place["rows"]))
    for across, up in place["tiles"]:
        tile = Image.open(io.BytesIO(parts[f"tile/{across}/{up}"])).convert("RGBA")
        x, y = across * TILE - place["left"], place["rows"] - ((up + 1) * TILE - place["bottom"])
        picture.paste(tile, (x, y))
    return np.asarray(picture)


def as_drawn(cells: np.ndarray) -> np.ndarray:
    """Grey and opacity of the cells, the greatest y first."""
    grey = np.where(cells < 0, 0, np.round(255 - 2.55 * cells)).astype(np.uint8)
    return np.stack([grey, np.where(cells < 0, 0, 255)], axis=2)[::-1]


@pytest.mark.parametrize(("x_m", "y_m"), [(0.0, 0.0), (-3.7, 2.1), (12.8, -40.0)])
def test_tiles_together_equal_the_map_for_any_corner(x_m: float, y_m: float) -> None:
    cells = some_cells(150, 270)
    shown = put_together(MapTiles().draw(map_of(cells, x_m, y_m)))
    seen = as_drawn(cells)[:, :, 1] > 0
    assert np.array_equal(shown[:, :, 3], as_drawn(cells)[:, :, 1])
    assert np.array_equal(shown[:, :, 0][seen], as_drawn(cells)[:, :, 0][seen])


def test_only_changed_tiles_are_drawn_again() -> None:
    tiles, cells = MapTiles(), some_cells(3 * TILE, 3 * TILE)
    before = tiles.draw(map_of(cells))
    cells[TILE + 5, 2 * TILE + 5] ^= 1
    after = tiles.draw(map_of(cells))
    assert {name for name in after if after[name] is not before[name]} == {"place", "tile/2/1"}
    assert before["place"] == after["place"]


def test_map_that_grows_on_all_sides_keeps_its_tiles() -> None:
    tiles, cells = MapTiles(), some_cells(4 * TILE, 4 * TILE)
    before = tiles.draw(map_of(cells))
    after = tiles.draw(map_of(np.pad(cells, 37, constant_values=-1), -37 * CELL_M, -37 * CELL_M))
    assert all(after[name] is before[name] for name in before if name != "place")
    assert np.array_equal(put_together(after)[37:-37, 37:-37], put_together(before))


def test_unknown_areas_have_no_tile() -> None:
    cells = np.full((2 * TILE, 2 * TILE), -1, np.int8)
    cells[0, 0] = 0
    assert set(MapTiles().draw(map_of(cells))) == {"place", "tile/0/0"}


def test_very_large_map_is_shown_with_every_second_cell_at_the_same_place() -> None:
    cells = np.full((1000, MAX_PIXELS // 1000 + 2), -1, np.int8)
    cells[0, 2] = 100
    parts = MapTiles().draw(map_of(cells))
    place = json.loads(parts["place"])
    assert (place["rows"], place["columns"], place["pixel_m"]) == (
        500,
        cells.shape[1] // 2,
        pytest.approx(0.2),
    )
    assert np.argwhere(put_together(parts)[:, :, 3]).tolist() == [[499, 1]]


@pytest.mark.parametrize(
    "info", [MapMetaData(resolution=1.0), MapMetaData(width=2, height=2), MapMetaData(resolution=1, width=3)]
)
def test_invalid_map_is_not_drawn(info: MapMetaData) -> None:
    assert MapTiles().draw(OccupancyGrid(info=info, data=np.zeros(4, np.int8))) == {}


def test_page_is_told_which_part_of_the_map_is_known() -> None:
    cells = np.full((200, 300), -1, np.int8)
    assert json.loads(MapTiles().draw(map_of(cells))["place"])["known"] is None
    cells[40:50, 100:130] = 0
    assert json.loads(MapTiles().draw(map_of(cells))["place"])["known"] == [100, 40, 130, 50]
