"""The stock robots drive and map with the drivers of real hardware, on serial lines to emulated devices."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from hw.simulation.arena_file import read_arena
from tests.robot.test_stock_robot import PROJECT, StockRobot
from tools.emulation_trial import away_from_walls_m

ARENA = PROJECT / "hw" / "simulation" / "arenas" / "demo.yaml"


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[StockRobot]:
    made = StockRobot(tmp_path)
    yield made
    made.close()


@pytest.mark.slow
def test_bytes_of_serial_devices_become_a_map_of_the_arena(robot: StockRobot) -> None:
    robot.start(
        "demo-emulated", "--set", "exploration.time_limit_s=4", "--set", "exploration.returns_home=false"
    )
    code, modules, errors = robot.wait(60)
    assert code == 0, errors
    assert json.loads((robot.output / "base.json").read_text())["collisions"] == 0
    assert modules["mapping"]["handled"] > 100
    away_m = away_from_walls_m(read_arena(ARENA), robot.output / "map.yaml")
    assert len(away_m) > 200 and float(away_m.mean()) < 0.05
    assert not list((robot.output / "ports").iterdir())
