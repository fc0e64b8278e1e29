"""Figures of `robbie top` compared with other sources, in one run under a known load."""

import math
from bisect import bisect_right
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import psutil
import pytest

from robbie_mp.base.utc import time_from
from robbie_mp.bus.observe import rates_between
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.histogram import ABSOLUTE_ERROR_S, RELATIVE_ERROR
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.messages import LaserScan
from tests._support.robot import robot_in
from tests.bus.observe._support.top_evidence import (
    BURST,
    CLOCK_TICK_S,
    HEARERS,
    INTERVAL_S,
    KEPT,
    MODULES,
    PAIRS,
    QUEUE,
    SLOW_S,
    Evidence,
    gathered,
)

BEHIND_S = 2.0
"""How far the core may be behind the publishers on a busy machine."""
LOAD = Path(__file__).parent / "_support" / "load_modules.py"
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Evidence]:
    with robot_in(tmp_path_factory.mktemp("load")) as robot:
        (robot.folder / "zoo" / "load.py").write_text(LOAD.read_text())
        robot.write_profile("modules:\n  " + "\n  ".join(MODULES) + "\n")
        yield gathered(robot)


def quantile_s(times_ns: list[int], fraction: float) -> float:
    return sorted(times_ns)[math.ceil(fraction * len(times_ns)) - 1] / 1e9


def recorded(evidence: Evidence, name: str, at: int, which: int) -> list[int]:
    return [pair[which] for pair in evidence.books[name]["recorded"][str(at)]]


def test_counters_are_those_of_the_modules_themselves(evidence: Evidence) -> None:
    for number in range(PAIRS):
        assert evidence.module(f"talker{number}")["published"] == evidence.sent(f"talker{number}") > 0
    for name in HEARERS:
        module, handled = evidence.module(name), len(evidence.books[name]["took_ns"])
        assert module["handled"] == handled
        (books,) = module["subscriptions"]
        count = evidence.sent(books["topic"])
        assert books["routed"] == count == handled + books["dropped"]
        assert module["dropped"] == (count - handled if name == "slow" else 0)
        assert module["status"] == f"{handled} scans"
        assert module["states"] == "ear: LISTEN"
        assert (module["waiting"], module["left"], module["lost"], module["refused"]) == (0, 0, 0, 0)


def test_overflowing_queue_shows_its_limit_and_peak(evidence: Evidence) -> None:
    slow = evidence.module("slow")
    assert slow["queue_messages"] == slow["waiting_peak"] == QUEUE
    assert slow["dropped"] > 0


def test_channels_count_published_messages_and_bytes(evidence: Evidence) -> None:
    size = LaserScan(ranges=np.zeros(64, np.float32)).encoded_size()
    found = [one for one in evidence.final["channels"] if one["type_name"] == LaserScan.type_name]
    assert len(found) == PAIRS
    for channel in found:
        count = evidence.sent(channel["topic"])
        assert (channel["messages"], channel["bytes"]) == (count, count * size)
        assert channel["publishers"] == [channel["topic"]]
        assert len(channel["subscribers"]) == 1


def test_kept_messages_are_pinned(evidence: Evidence) -> None:
    keeper = evidence.module("keeper")
    size = LaserScan(ranges=np.zeros(64, np.float32)).encoded_size()
    assert (keeper["pinned"], keeper["pinned_bytes"], keeper["copied"]) == (KEPT, KEPT * size, 0)
    talker = evidence.module("talker7")
    assert (talker["outstanding"], talker["outstanding_bytes"]) == (KEPT, KEPT * size)
    assert evidence.final["core"]["handles"] >= KEPT


def test_p99_and_all_other_times_are_within_the_stated_error(evidence: Evidence) -> None:
    for name in HEARERS:
        for kind, which in (("latency", 0), ("handler", 1)):
            true_ns = recorded(evidence, name, layout.OUT_MESSAGE_FIGURES, which)
            found = evidence.module(name)["times"][kind]
            assert found["count"] == len(true_ns)
            assert found["max_s"] == max(true_ns) / 1e9
            assert found["mean_s"] == pytest.approx(sum(true_ns) / len(true_ns) / 1e9, abs=1e-9)
            for part, fraction in (("p50_s", 0.5), ("p99_s", 0.99)):
                true_s = quantile_s(true_ns, fraction)
                assert abs(found[part] - true_s) <= RELATIVE_ERROR * true_s + ABSOLUTE_ERROR_S


def test_handler_times_and_load_agree_with_the_modules_own_measurements(
    evidence: Evidence,
) -> None:
    for name in HEARERS:
        own_ns, found = evidence.books[name]["took_ns"], evidence.module(name)["times"]["handler"]
        work_s = SLOW_S if name == "slow" else 0.005
        assert found["p99_s"] >= (1 - 2 * RELATIVE_ERROR) * max(work_s, quantile_s(own_ns, 0.99))
        # What it takes to decode a message and give it back is little, mostly.
        assert found["p50_s"] <= (1 + 2 * RELATIVE_ERROR) * quantile_s(own_ns, 0.5) + 0.002


def sent_until(evidence: Evidence, number: int, at_s: float) -> int:
    """Return how many scans a talker had noted at a time, 0 before its first note.

    It may have sent one burst more.
    """
    notes = evidence.books[f"talker{number}"]["sent"]
    return int(notes[max(0, bisect_right([note[0] for note in notes], at_s) - 1)][1])


def test_rates_under_load_agree_with_the_publishers(evidence: Evidence) -> None:
    loaded = evidence.loaded
    interval_s = loaded["interval_s"]
    end_s = time_from(loaded["time"]).timestamp()
    begin_s = end_s - interval_s
    total_hz = 0.0
    for number in range(PAIRS):
        module = evidence.module(f"talker{number}", "loaded")
        channel = next(one for one in loaded["channels"] if one["topic"] == f"talker{number}")
        total_hz += channel["hz"]
        # A look begins at its time, and takes a while; the core may be behind.
        for after, hz, behind_s in (
            (module["published"], module["rates"]["out_hz"], 0.0),
            (channel["messages"], channel["hz"], BEHIND_S),
        ):
            before = after - hz * interval_s
            least = sent_until(evidence, number, end_s - behind_s)
            assert least <= after <= sent_until(evidence, number, evidence.loaded_until_s) + BURST
            least = sent_until(evidence, number, begin_s - behind_s)
            assert least - 1 <= before <= sent_until(evidence, number, end_s) + BURST + 1
    assert loaded["routed_hz"] == pytest.approx(total_hz, rel=0.5)
    assert loaded["routed_hz"] > 200, "that was no load"


def test_jitter_agrees_with_the_messages_times(evidence: Evidence) -> None:
    rates = rates_between(evidence.begun, evidence.ended)
    for number in range(PAIRS - 2):
        key = (LaserScan.type_name, LaserScan.version, f"talker{number}")
        begun = next(one for one in evidence.begun.channels if one.topic == f"talker{number}")
        stamps = np.array(evidence.books[f"hearer{number}"]["stamps_ns"][begun.messages - 1 :])
        assert stamps[0] == begun.last_ns
        assert rates.channels[key].jitter_s == pytest.approx(np.diff(stamps).std() / 1e9, abs=2e-6)
        age_s = next(one for one in evidence.final["channels"] if one["topic"] == f"talker{number}")["age_s"]
        assert 0 < age_s < (evidence.ended.at_ns - stamps[-1]) / 1e9


def test_processor_time_memory_and_threads_agree_with_psutil(evidence: Evidence) -> None:
    for module in evidence.loaded["modules"]:
        before, after = evidence.psutil_before[module["pid"]], evidence.psutil_after[module["pid"]]
        assert before["cpu_s"] - CLOCK_TICK_S <= module["cpu_s"] <= after["cpu_s"] + CLOCK_TICK_S
        assert (
            module["rates"]["cpu_percent"]
            <= 100 * (after["cpu_s"] - before["cpu_s"] + 2 * CLOCK_TICK_S) / INTERVAL_S
        )
        low, high = sorted((before["rss"], after["rss"]))
        assert 0.9 * low <= module["rss_bytes"] <= 1.1 * high
        assert module["threads"] in (before["threads"], after["threads"])
        now_s = time_from(evidence.loaded["time"]).timestamp()
        assert now_s - evidence.begun.wall_time_s - 0.1 < module["uptime_s"] < now_s - before["start"] + 0.1
    for early_s, found_s, late_s in zip(
        evidence.processors[0], evidence.loaded["machine"]["cpu_busy_s"], evidence.processors[1], strict=True
    ):
        assert early_s <= found_s <= late_s
    assert evidence.loaded["machine"]["memory_total_bytes"] == psutil.virtual_memory().total
    assert (
        evidence.loaded["machine"]["shared_memory_total_bytes"] == psutil.disk_usage(str(SHARED_MEMORY)).total
    )


def test_profiler_publishes_the_same_figures(evidence: Evidence) -> None:
    said = evidence.books["reporter"]["said"]
    assert len(said) > 5
    for before, now in pairwise(said):
        for topic, channel in now["channels"].items():
            more = channel["messages"] - before["channels"].get(topic, {"messages": 0})["messages"]
            assert channel["hz"] * now["interval_s"] == pytest.approx(more, rel=1e-5, abs=1e-3)
    messages = {topic: channel["messages"] for topic, channel in said[-1]["channels"].items()}
    assert messages == {f"talker{number}": evidence.sent(f"talker{number}") for number in range(PAIRS)}
    pids = {module["name"]: module["pid"] for module in evidence.final["modules"]}
    assert {name: module["pid"] for name, module in said[2]["modules"].items()} == pids
    busiest = max(said, key=lambda one: one["modules"]["slow"]["in_hz"])["modules"]
    assert busiest["slow"]["in_hz"] == pytest.approx(1 / SLOW_S, rel=0.5)
    assert busiest["slow"]["p99"] >= SLOW_S
    assert busiest["slow"]["state"] == "RUNNING"


def test_recording_has_a_line_for_each_process_and_interval_until_the_run_ends(evidence: Evidence) -> None:
    assert evidence.recorder_exit_code == 0
    by_time: dict[str, list[dict[str, str]]] = {}
    for row in evidence.recorded:
        by_time.setdefault(row["time"], []).append(row)
    assert len(by_time) > 10
    names = [module["name"] for module in evidence.final["modules"]]
    assert all([row["module"] for row in rows] == names for rows in by_time.values())
    last = {row["module"]: row for row in next(reversed(by_time.values()))}
    assert last["talker0"]["published"] == str(evidence.sent("talker0"))
    assert last["core"]["restarts"] == "1"
    slow = [row["handler_p99_s"] for row in evidence.recorded if row["module"] == "slow"]
    assert min(float(text) for text in slow if text) > SLOW_S * (1 - 2 * RELATIVE_ERROR)


def test_segments_are_those_in_dev_shm(evidence: Evidence) -> None:
    assert {one["name"]: one["bytes"] for one in evidence.final["segments"]} == evidence.stat_bytes
    for module in evidence.final["modules"][1:-1]:
        if module["pid"] and module["name"] != "core":
            own = [
                one["bytes"]
                for one in evidence.final["segments"]
                if (one["kind"], one["module"]) == ("data", module["name"])
            ]
            assert module["segment_bytes"] == sum(own)


def test_hung_module_shows_its_handler_and_duration_before_the_watchdog_acts(evidence: Evidence) -> None:
    hanger = evidence.module("hanger", "hung")
    assert hanger["state"] == "RUNNING"
    assert (hanger["activity"], hanger["handler"]) == ("handler", "Hanger.on_command")
    assert hanger["busy_s"] > 1.0


def test_every_reading_has_all_modules_while_the_core_restarts(evidence: Evidence) -> None:
    assert set(evidence.while_core_died) == {len(MODULES) + 2}


def test_observers_can_neither_write_nor_wake_a_process(evidence: Evidence) -> None:
    assert len(evidence.maps) >= len(MODULES)
    for line in evidence.maps:
        assert line.split()[1] == "r--s"
        assert "sem." not in line


def test_observers_cost_core_and_modules_no_system_call(evidence: Evidence) -> None:
    if not evidence.calls or any(math.isnan(count) for pair in evidence.calls.values() for count in pair):
        pytest.skip("there is no strace here, or it may not look")
    for name, (unwatched, watched) in evidence.calls.items():
        assert unwatched > 0.9, f"{name} was not seen to work"
        assert watched < 1.25 * unwatched, "a watcher that took part would at least double it"
