"""The operator of the drive through the maze plans on the map that it sees, and holds keys for its way."""

import math

import numpy as np
import pytest

pytest.importorskip("playwright", reason="the operator uses a browser")

from tools.operator.drive.__main__ import TOUR, places
from tools.operator.drive.eyes import CELL_M, Sight
from tools.operator.drive.hands import NoWay, keys_for, way_on

EAST = np.array([[x / 10, 0.0] for x in range(20)])


def sight(*, gap: bool, unknown: bool = False) -> Sight:
    """A room of 4 m x 2 m with a wall across it at x = 2 m, which may have a gap at the top."""
    cells = np.zeros((40, 80), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[: 24 if gap else 40, 40] = 100
    if unknown:
        cells[:, 50:] = -1
    return Sight(cells, (0.0, 0.0), (1.0, 0.5, 0.0), 320)


@pytest.mark.parametrize("unknown", [False, True])
def test_way_leads_through_the_gap_also_to_what_is_unknown(unknown: bool) -> None:
    way = way_on(sight(gap=True, unknown=unknown), (3.0, 0.5))
    assert math.dist(way[0], (1.0, 0.5)) < 2 * CELL_M
    assert math.dist(way[-1], (3.0, 0.5)) < 2 * CELL_M
    assert way[:, 1].max() > 1.3


def test_no_way_is_reported() -> None:
    with pytest.raises(NoWay, match="no way to"):
        way_on(sight(gap=False), (3.0, 0.5))


@pytest.mark.parametrize(
    ("heading_deg", "keys"),
    [
        (0, ("KeyW",)),
        (20, ("KeyW", "KeyD")),
        (-20, ("KeyW", "KeyA")),
        (90, ("KeyD",)),
        (-170, ("KeyA",)),
        (355, ("KeyW",)),
    ],
)
def test_keys_turn_to_the_way_and_drive_along_it(heading_deg: int, keys: tuple[str, ...]) -> None:
    assert keys_for((0.0, 0.0, math.radians(heading_deg)), EAST) == keys


def test_places_are_in_front_of_victims_of_the_maze() -> None:
    assert len(set(places(5))) == 5
    assert len(TOUR) == len(set(TOUR)) == 6
