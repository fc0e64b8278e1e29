"""A no-go area that cuts the robot off from home is found before it is saved."""

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="the operator's page needs the extra gui")

from types import SimpleNamespace
from typing import Any

from robbie_mp.messages import (
    MapAnnotations,
    MapMetaData,
    NoGoArea,
    OccupancyGrid,
    Point,
    PointOfInterest,
    Pose,
    PoseStamped,
)
from robbie_mp.station.watch.latest import Latest
from robbie_robots.modules.rescue.station.way_home import WARNING, WayHome

RESOLUTION_M = 0.05


def way_home(*known: list[Point]) -> WayHome:
    """A corridor 4 m long and 1 m wide, with the home at its left end."""
    cells = np.full((24, 84), 100, np.int8)
    cells[2:-2, 2:-2] = 0
    info = MapMetaData(resolution=RESOLUTION_M, width=84, height=24)
    grid, pose = Latest[Any](), Latest[Any]()
    grid.put(OccupancyGrid(info=info, data=cells.ravel()))
    pose.put(PoseStamped(pose=Pose(position=Point(x=3.0, y=0.6))))
    annotations = Latest[Any]()
    annotations.put(MapAnnotations(no_go=[NoGoArea(corners=corners) for corners in known]))
    home = PointOfInterest(name="home", pose=Pose(position=Point(x=0.6, y=0.6)))
    holders = {"OccupancyGrid": grid, "PoseStamped": pose, "MapAnnotations": annotations}
    messages = SimpleNamespace(newest=lambda kind, _topic="": holders[kind.__name__])
    station: Any = SimpleNamespace(
        messages=messages,
        settings=SimpleNamespace(map_topic=""),
        map=SimpleNamespace(places=SimpleNamespace(places=(home,))),
    )
    return WayHome(station)


def area(left_m: float, bottom_m: float, right_m: float, top_m: float) -> list[Point]:
    places = ((left_m, bottom_m), (right_m, bottom_m), (right_m, top_m), (left_m, top_m))
    return [Point(x=x_m, y=y_m) for x_m, y_m in places]


@pytest.mark.parametrize(
    ("corners", "warning"),
    [
        (area(1.5, 0.0, 2.0, 1.2), WARNING),  # across the corridor
        (area(1.5, 0.0, 2.0, 0.8), WARNING),  # leaves a gap that is too narrow for the robot
        (area(1.5, 0.0, 2.0, 0.3), ""),
        (area(3.5, 0.0, 4.0, 1.2), ""),  # behind the robot
        (area(0.4, 0.4, 0.8, 0.8), WARNING),  # around the home
    ],
)
def test_area_that_cuts_off_home_is_found(corners: list[Point], warning: str) -> None:
    assert way_home().warning(corners) == warning


def test_robot_that_is_cut_off_already_is_not_warned_of_again() -> None:
    assert way_home(area(1.0, 0.0, 1.2, 1.2)).warning(area(1.5, 0.0, 2.0, 1.2)) == ""
