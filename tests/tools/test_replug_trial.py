"""Pulled cables of a running robot: how the trial counts, and that the robot goes on."""

import math
import random
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from robbie_mp.bus.observe import ModuleFigures
from robbie_mp.bus.transport.histogram import Histogram
from robbie_mp.bus.transport.layout import HISTOGRAM_BUCKETS
from tools.trials.devices.replug import WITNESSES, Replugs, Trial, Waits, as_text, violations


def test_what_took_too_long_is_a_violation() -> None:
    good = Replugs(told_s=[0.1], back_s=[0.5], stands_s=[0.3], ways_m=[0.1], drives_s=[9.0])
    assert violations(Trial({"base": good})) == []
    bad = Replugs(back_s=[0.5, 2.1], stands_s=[0.5], stale=3)
    assert violations(Trial({"base": bad}, collisions=1, restarts=2)) == [
        "base was back after more than 2 s, 1 times",
        "the robot stood after more than 0.4 s, 1 times",
        "3 measurements of base without the device",
        "2 restarts",
        "1 collisions",
    ]
    assert "base: 2 replugs" in as_text(Trial({"base": bad}))


def test_rounds_are_those_that_each_device_has_made() -> None:
    assert Trial({"base": Replugs(back_s=[0.1, 0.2]), "imu": Replugs(back_s=[0.1])}).rounds == 1


def test_waits_of_several_times_count_together() -> None:
    def seen(fast: int, slow: int) -> dict[str, ModuleFigures]:
        counts = np.zeros(HISTOGRAM_BUCKETS, np.int64)
        counts[[10, 200]] = fast, slow
        work = SimpleNamespace(latency=Histogram(0, 0, counts))
        return dict.fromkeys(WITNESSES, cast("ModuleFigures", SimpleNamespace(work=work)))

    waits = Waits()
    waits.add(seen(0, 0), seen(90, 0))
    few_ms = waits.p99_ms()["mapping"]
    waits.add(seen(500, 500), seen(508, 502))  # what was between the two times does not count
    assert waits.p99_ms()["mapping"] > 100 * few_ms


@pytest.mark.slow
@pytest.mark.timeout(420)
def test_robot_goes_on_after_each_of_its_cables_was_pulled(tmp_path: Path) -> None:
    result = Trial()
    result.run(tmp_path, rounds=1, until_s=math.inf, calm_s=0.0, chance=random.Random(1))
    assert result.rounds == 1
    assert result.restarts == 0
    assert all(each.stale == 0 for each in result.replugs.values())
    assert len(result.replugs["base"].drives_s) == len(result.replugs["base"].stands_s) == 1
