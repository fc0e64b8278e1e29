"""The benchmark of the scene graph measures the described worlds."""

import json

import pytest

from robbie_mp.scene import SceneGraph
from tools.bench.scene_graph import main, row, world_of_robots


def test_worlds_are_trees_of_200_nodes() -> None:
    assert len(SceneGraph(world_of_robots())) == 201
    assert len(SceneGraph(row())) == 200


def test_figures_of_each_world_are_reported(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--seconds", "0.3", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told) == {"four robots", "one row"}
    assert told["four robots"]["joints"] == 60
    assert all(figure > 0 for figures in told.values() for figure in figures.values())
