"""The trial of drivers on emulated devices measures what it says."""

from pathlib import Path

from tools.trials.devices.drivers import TRIALS, cost, replug


def test_every_replug_is_timed(tmp_path: Path) -> None:
    result = replug(TRIALS["pioneer"], 1, tmp_path)
    assert len(result.back_s) == len(result.stands_s) == 1
    assert 0 < result.back_s[0] < 20 and result.stands_s[0] > 0


def test_processor_time_and_rate_are_measured(tmp_path: Path) -> None:
    share, rate_hz = cost(TRIALS["dynamixel"], 0.3, tmp_path)
    assert 0 < share < 1 and rate_hz > 0
