"""Every driver finds its device again after the plug was pulled, on emulated devices."""

from pathlib import Path

import pytest

from tests.hw._support.every_driver import TRIALS, replug


@pytest.mark.sampled(8)
@pytest.mark.slow
@pytest.mark.parametrize("name", TRIALS)
def test_driver_is_back_after_a_replug(name: str, tmp_path: Path) -> None:
    result = replug(TRIALS[name], 1, tmp_path)
    assert len(result.back_s) == 1
    assert len(result.stands_s) == (1 if TRIALS[name].stands else 0)
