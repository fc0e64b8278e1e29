"""Stamps of all lasers and bases are within 1 ms of the emulated device's clock, in simulated time."""

import numpy as np
import pytest

from robbie_robots.hw.emulation.faults import Faults
from tests.hw._support.stamps import LATE, STAMP_S, SUBJECTS, stamp_errors


@pytest.mark.slow
@pytest.mark.parametrize("name", SUBJECTS)
def test_stamps_are_within_a_millisecond(name: str) -> None:
    errors = stamp_errors(SUBJECTS[name], 2.0 if name == "UTM-30LX" else 8.0, seed=1)
    assert len(errors) >= 20
    # Two scans a second: the filter has heard few of them.
    limit_s = 2 * STAMP_S if "9600" in name else STAMP_S
    assert np.abs(errors).max() <= limit_s, name


def test_damaged_telegrams_spoil_the_stamps_of_hardly_any_others() -> None:
    faults = Faults(LATE.jitter_s, bit_error_rate=2e-5)
    errors = stamp_errors(SUBJECTS["LMS2xx, 500000, 180 by 0.5"], 20.0, faults=faults)
    assert (np.abs(errors) <= STAMP_S).mean() > 0.98


def test_constant_delay_is_seen_by_nobody() -> None:
    errors = stamp_errors(SUBJECTS["LMS111, CoLa B"], 2.0, faults=Faults(late_share=1.0, late_s=0.01))
    assert errors == pytest.approx(0.01, abs=1e-4)
