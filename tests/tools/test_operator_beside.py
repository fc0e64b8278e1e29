"""The evaluation of what a page costs other modules, and the control in its place."""

import time

import numpy as np
import psutil

from robbie_mp.bus.transport.histogram import quantile_s
from robbie_mp.bus.transport.layout import HISTOGRAM_BUCKETS
from tests._support.robot import LIMIT_S
from tools.operator.beside import (
    CONTROL,
    PAGE,
    WITHOUT,
    SessionPart,
    ThreadLoad,
    as_table,
    cpu_s,
    imitated,
    loads_between,
)


def test_each_thread_that_woke_up_is_imitated() -> None:
    before = {1: (1.0, 100), 3: (9.0, 7)}
    now = {1: (2.0, 300), 2: (0.5, 50), 3: (9.5, 7)}
    assert loads_between(before, now, 2.0, 19) == [ThreadLoad(0.5, 100.0, 19), ThreadLoad(0.25, 25.0, 19)]


def test_control_computes_until_its_end() -> None:
    with imitated([ThreadLoad(0.9, 50.0, 0), ThreadLoad(0.9, 500.0, 0)]) as pids:
        until_s = time.monotonic() + LIMIT_S
        while min(cpu_s([pid]) for pid in pids) < 0.5 and time.monotonic() < until_s:
            time.sleep(0.1)
        assert min(cpu_s([pid]) for pid in pids) >= 0.5
    assert not any(psutil.pid_exists(pid) for pid in pids)


def test_ratios_are_those_of_all_messages_together() -> None:
    quick, slow, slower = (
        np.eye(1, HISTOGRAM_BUCKETS, bucket, dtype=np.int64)[0] for bucket in (40, 100, 116)
    )
    parts = [
        SessionPart(WITHOUT, 98 * quick + 2 * slow, 5.0),
        SessionPart(WITHOUT, 98 * quick + 2 * slow, 5.0),
        SessionPart(PAGE, 100 * slower, 5.0),
        SessionPart(PAGE, 5000 * quick + 2 * slower, 5.0),
        SessionPart(CONTROL, 100 * quick, 5.0),
    ]
    table = as_table(parts)
    assert f"page ÷ without: {quantile_s(slower, 1) / quantile_s(slow, 1):.2f}" in table
    assert f"page ÷ control: {quantile_s(slower, 1) / quantile_s(quick, 1):.2f}" in table
