"""A robot that runs the project's profiles."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.robot._support.stock_robot import StockRobot


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[StockRobot]:
    made = StockRobot(tmp_path)
    yield made
    made.close()
