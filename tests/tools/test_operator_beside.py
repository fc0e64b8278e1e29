"""The evaluation of what a page costs other modules, and the control in its place."""

import time

import psutil

from tests._support.robot import LIMIT_S
from tools.operator.beside import CONTROL, PAGE, WITHOUT, ThreadLoad, as_table, cpu_s, imitated, loads_between


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


def test_ratios_are_those_of_medians() -> None:
    p99_us = {WITHOUT: (100.0, 500.0, 200.0), PAGE: (300.0, 260.0, 1.0), CONTROL: (240.0, 250.0, 9000.0)}
    results = [
        {"session": name, "p50_us": 1.0, "p99_us": one, "percent of a processor": 5.0}
        for name, all_us in p99_us.items()
        for one in all_us
    ]
    table = as_table(results)
    assert "page ÷ without, medians: 1.30" in table
    assert "control ÷ without, medians: 1.25" in table
    assert "page ÷ control, medians: 1.04" in table
