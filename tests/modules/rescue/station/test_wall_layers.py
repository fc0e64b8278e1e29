"""Searched walls are layers of the operator's map."""

from types import SimpleNamespace

import numpy as np

from robbie_mp.messages import MapMetaData, Point, Pose
from robbie_mp.station.map.marks import MAX_CELLS, CellMarks, MapMarks
from robbie_mp.station.watch.latest import Latest
from robbie_robots.modules.rescue.messages import SearchedWalls
from robbie_robots.modules.rescue.station.wall_layers import add_wall_layers


def test_searched_walls_and_those_to_search_are_layers_of_the_map() -> None:
    newest: Latest[SearchedWalls] = Latest()
    marks = MapMarks()
    add_wall_layers(SimpleNamespace(newest=lambda _type: newest), marks)
    searched, others = marks.layers
    assert (searched.title, others.title) == ("Searched walls", "Walls to search")
    assert len(searched.source().middles) == 0
    info = MapMetaData(resolution=0.5, width=3, height=2, origin=Pose(position=Point(x=-1.0, y=2.0)))
    newest.put(SearchedWalls(info=info, data=np.array([-1, 100, 0, -1, -1, 100], np.int8)))
    assert searched.source().revision == 1
    assert searched.source().middles.tolist() == [[-0.25, 2.25], [0.25, 2.75]]
    assert others.source().thinned().tolist() == [[0.25, 2.25, 0.0]]


def test_number_of_cells_of_a_layer_is_bounded() -> None:
    many = CellMarks(1, np.zeros((2 * MAX_CELLS + 1, 2)))
    assert 0 < len(many.thinned()) <= MAX_CELLS
