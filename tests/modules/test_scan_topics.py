"""Modules that use one laser of several keep to its topic; without one, they take any laser."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_mp import Module, ModuleHarness
from robbie_mp.messages import LaserScan
from robbie_mp.module.harness import NotSubscribed
from robbie_robots.modules.home.mapping import MappingAmongPeople
from robbie_robots.modules.maps.localization import MonteCarloLocalization
from robbie_robots.modules.maps.mapping import Mapping
from robbie_robots.modules.navigation.exploration import Exploration
from robbie_robots.modules.navigation.navigation import Navigation
from robbie_robots.modules.parcours import Parcours

SCAN = LaserScan(angle_increment=0.1, range_max=10.0, ranges=np.full(60, 3.0, np.float32))


@pytest.mark.parametrize(
    "module", [Exploration, Mapping, MappingAmongPeople, MonteCarloLocalization, Navigation, Parcours]
)
@pytest.mark.parametrize(("settings", "expected"), [({}, 3), ({"scan_topic": "scan"}, 1)])
def test_module_takes_only_the_scans_of_the_laser_that_it_is_told_to_use(
    module: type[Module],
    settings: dict[str, object],
    expected: int,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    taken: list[LaserScan] = []

    def on_scan(_self: Any, scan: LaserScan) -> None:
        taken.append(scan)

    monkeypatch.setattr(module, "on_scan", on_scan)
    with ModuleHarness(module, settings, output_directory=tmp_path) as harness:
        for topic in ("", "scan", "rear_scan"):
            with suppress(NotSubscribed):
                harness.send(SCAN, topic=topic)
        assert len(taken) == expected
