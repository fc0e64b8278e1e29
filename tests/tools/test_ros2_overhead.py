"""A short play of the measurement of large images to ROS 2."""

import pytest

from tests.ros2.test_zenoh import zenoh_has_started
from tools.bench.ros2_overhead import measure

__all__ = ["zenoh_has_started"]


@pytest.mark.slow
def test_images_arrive_both_ways() -> None:
    result = measure("zenoh", 3)
    assert (len(result.bridged_s), len(result.plain_s)) == (3, 3)
    assert min(result.bridged_s + result.plain_s) > 0
    assert result.line().strip().startswith("zenoh: bridge ")
