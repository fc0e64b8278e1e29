"""Modules that need a sensor say so when it is silent."""

import pytest

from robbie_mp import Module, ModuleHarness
from robbie_mp.messages import LaserScan
from robbie_robots.modules.maps.localization import MonteCarloLocalization
from robbie_robots.modules.maps.mapping import Mapping
from robbie_robots.modules.people.people import PeopleFinder
from robbie_robots.modules.sensor_deadlines import LASER_S, ODOMETRY_S


@pytest.mark.parametrize("module_class", [Mapping, MonteCarloLocalization, PeopleFinder])
def test_module_is_degraded_without_a_laser(
    module_class: type[Module], caplog: pytest.LogCaptureFixture
) -> None:
    with ModuleHarness(module_class) as harness:
        harness.advance(LASER_S - 0.1)
        assert "DEGRADED" not in caplog.text
        harness.advance(0.2)
    assert "DEGRADED: no LaserScan" in caplog.text


def test_laser_alone_does_not_tell_a_mapping_robot_where_it_is(caplog: pytest.LogCaptureFixture) -> None:
    with ModuleHarness(Mapping) as harness:
        for _ in range(round(ODOMETRY_S / 0.1) + 1):
            harness.send(LaserScan(), topic=harness.module.scan_topic)
            harness.advance(0.1)
    assert "no Odometry on topic 'odom' for 1.0 s" in caplog.text
    assert "no LaserScan" not in caplog.text
