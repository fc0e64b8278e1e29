"""A short play of the measurement of large images to ROS 2."""

import pytest

from tests.ros2.test_zenoh import zenoh_has_started
from tools.bench.ros2_overhead import NAMES, measure

__all__ = ["zenoh_has_started"]


@pytest.mark.slow
def test_images_arrive_all_ways() -> None:
    result = measure("zenoh", 3)
    assert {name: len(times_s) for name, times_s in result.times_s.items()} == dict.fromkeys(NAMES, 3)
    assert min(map(min, result.times_s.values())) > 0
    assert result.line().strip().startswith("zenoh: bridge ")
