"""The benchmarks with tiny counts: their measurements, and their reports of absent contenders."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest

from robbie_mp.run.profile.model import CoreLimits, QueueLimits
from tests._support.present import present
from tools.bench.__main__ import main
from tools.bench.contender import PeerContender, Trouble, wait_for_end
from tools.bench.options import Options, peer, read_variant
from tools.bench.peers.peer import Peer
from tools.bench.processes import mapped_names, remove_unmapped
from tools.bench.robbie import RobbieContender, scheduling_of
from tools.bench.robbie_modules import FLAT_OUT_OUTSTANDING
from tools.bench.rounds import Series, run_rounds, run_work
from tools.bench.work import Work

WORK = Work("", Path(), count=30, warm_up=3)


class Missing(Peer):
    title = "missing"
    package = "no-such-package"
    module = "no_such_package"
    how = "not at all"


class Broken(Peer):
    title = "broken"
    how = "its daemon does not run"

    def commands(self, name: str, work: Work, work_file: Path) -> list[list[str]]:
        return [[sys.executable, "-c", "import sys; print('started'); sys.exit('the daemon does not run')"]]


class Hanging(Peer):
    title = "hanging"
    how = "it starts a child and waits for ever"

    def commands(self, name: str, work: Work, work_file: Path) -> list[list[str]]:
        child = "import signal; signal.pause()"
        parent = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}])"
        return [[sys.executable, "-c", parent]]


def measure(tmp_path: Path, *arguments: str) -> dict[str, Any]:
    """Run the command line; return its results."""
    file = tmp_path / "results.json"
    assert main([*arguments, "--json", str(file), "--rounds=1"]) == 0
    results: dict[str, Any] = json.loads(file.read_text())
    return results


def test_latency_of_robbie_and_others_in_one_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = measure(tmp_path, "latency", "--only=floor,robbie,zeromq", "--count=40")
    floor, robbie, zeromq = run["results"][0]["contenders"]
    for row in (floor, robbie, *([] if zeromq["trouble"] else [zeromq])):
        assert (row["sent"], row["lost"], row["trouble"]) == ([40], [0], "")
        assert 0 < row["p50_us"][0] <= row["p99_us"][0] < 1e6
    printed = capsys.readouterr().out
    assert "p50 ÷ floor" in printed
    assert run["machine"]["cores"] > 0


def test_round_trip_of_a_call_is_compared_with_one_way(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = measure(tmp_path, "call", "--only=robbie,robbie-call", "--count=40")
    one_way, call = run["results"][0]["contenders"]
    for row in (one_way, call):
        assert (row["sent"], row["lost"], row["trouble"]) == ([40], [0], "")
        assert 0 < row["p50_us"][0] < 1e6
    assert "call and reply, 64 B each: p50 ÷ one way" in capsys.readouterr().out


def test_every_picture_reaches_the_base_through_all_stages(tmp_path: Path) -> None:
    run = measure(tmp_path, "pipeline", "--only=robbie,robbie-watched", "--count=15")
    rows = {row["name"]: row for row in run["results"][0]["contenders"]}
    assert set(rows) == {"robbie in place", "robbie", "robbie-watched in place"}
    for row in rows.values():
        assert (row["sent"], row["lost"], row["trouble"]) == ([15], [0], ""), row
        assert 0 < row["p50_us"][0] < 1e7 and row["cpu_percent"][0] > 0


@pytest.mark.parametrize("name", ["iceoryx2", "dora"])
def test_peers_pass_pictures_through_all_stages(tmp_path: Path, name: str) -> None:
    if why := peer(name).why_absent:
        pytest.skip(why)
    run = measure(tmp_path, "pipeline", f"--only={name}", "--count=15")
    for row in run["results"][0]["contenders"]:
        assert (row["sent"], row["trouble"]) == ([15], ""), row
        assert row["lost"][0] < 15 and 0 < row["p50_us"][0] < 1e7


@pytest.mark.skipif(bool(peer("rclpy_relay").why_absent), reason=peer("rclpy_relay").why_absent)
def test_bridge_to_ros_is_compared_with_a_relay_of_rclpy(tmp_path: Path) -> None:
    run = measure(tmp_path, "relay", "--count=5")
    for result in run["results"]:
        for row in result["contenders"]:
            assert (row["sent"], row["trouble"]) == ([5], ""), row
            assert 0 < row["p50_us"][0] < 5e6


def test_all_processes_run_on_the_processors_of_the_work() -> None:
    cpu = min(os.sched_getaffinity(0))
    work = replace(WORK, cpus=(cpu,), realtime_priority=7)
    profile = RobbieContender().profile({"one": {}}, scheduling_of(work))
    wanted = {"cpus": [cpu], "realtime_priority": 7}
    assert profile["core"] == {"scheduling": wanted}
    assert profile["modules"]["one"]["scheduling"] == wanted
    assert scheduling_of(WORK) == {}


def test_burst_of_a_flat_out_publisher_fits_into_ring_and_queue() -> None:
    core, queue = CoreLimits(), QueueLimits()
    assert min(core.ring_records - 2 * core.credits, queue.messages) > FLAT_OUT_OUTSTANDING


def test_arrays_copied_and_filled_in_place_reach_the_last_subscriber(tmp_path: Path) -> None:
    run = measure(tmp_path, "fanout", "--only=robbie", "--count=3", "--modules=2")
    rows = {row["name"]: row for row in run["results"][0]["contenders"]}
    assert set(rows) == {"robbie in place", "robbie"}
    assert all(row["sent"] == [3] for row in rows.values())
    assert rows["robbie"]["lost"] == rows["robbie in place"]["lost"] == [0]


def test_robbie_loses_nothing_at_full_throughput(tmp_path: Path) -> None:
    run = measure(tmp_path, "throughput", "--only=robbie", "--count=3000")
    (row,) = run["results"][0]["contenders"]
    assert (row["sent"], row["lost"]) == ([3000], [0])
    assert row["received_per_s"][0] > 0


def test_idle_modules_take_processor_time(tmp_path: Path) -> None:
    run = measure(tmp_path, "idle", "--only=robbie", "--modules=2", "--seconds=0.6")
    (row,) = run["results"][0]["contenders"]
    assert 0 < row["cpu_percent"][0] < 200


def test_loaded_modules_are_compared_with_the_floor(tmp_path: Path) -> None:
    run = measure(tmp_path, "loaded", "--only=robbie,floor", "--modules=2", "--seconds=0.3", "--rounds=1")
    for row in run["results"][0]["contenders"]:
        assert row["trouble"] == ""
        assert 0 < row["us_per_message"][0] < 1e4


def test_time_from_kill_to_the_next_message_is_measured(tmp_path: Path) -> None:
    run = measure(tmp_path, "restart", "--quick", "--count=1")
    (row,) = run["results"][0]["contenders"]
    assert len(row["away_ms"]) == 1
    assert 0 < row["away_ms"][0] < 60_000


def test_variant_changes_the_profile_that_is_measured(tmp_path: Path) -> None:
    file = tmp_path / "few.yaml"
    file.write_text("core: {credits: 2}\nmodule: {queue: {messages: 5}}\nblack_box: false")
    usual, few = Options(variants=dict([read_variant(f"few={file}")])).robbies()
    assert (usual.name, few.name) == ("robbie", "few")
    work = Work("variant", tmp_path, subscribers=2)
    profile = few.profile(few.pair(work))
    assert profile["core"] == {"credits": 2}
    assert profile["black_box"] is False
    assert set(profile["modules"]) == {"subscriber-0", "subscriber-1", "publisher"}
    assert all(module["queue"] == {"messages": 5} for module in profile["modules"].values())
    assert "credits" in few.how and "credits" not in usual.how


def test_absent_or_broken_contenders_are_reported_and_the_others_are_measured() -> None:
    series = [Series(PeerContender(one.title, one)) for one in (Missing(), Broken())]
    series.append(Series(peer("memcpy"), {"size_bytes": 4096}))
    missing, broken, memcpy = run_work(series, WORK, rounds=2)
    assert missing["trouble"] == "no-such-package is not installed"
    assert broken["trouble"] == "a process ended with 1: the daemon does not run"
    assert memcpy["lost"] == [0, 0]


def test_each_round_begins_with_a_different_contender() -> None:
    series = [Series(PeerContender(name, Broken())) for name in "abc"]
    order = []
    run_rounds(series, lambda one: order.append(one.contender.name), rounds=3)
    assert "".join(order) == "abcbcacab"


def test_hanging_contender_is_killed_with_its_children(tmp_path: Path) -> None:
    contender = PeerContender("hanging", Hanging())
    work = replace(WORK, folder=tmp_path)
    with pytest.raises(Trouble, match="did not end within"), contender.started(work) as processes:
        parent = psutil.Process(processes[0].pid)
        while not parent.children():
            assert processes[0].poll() is None
        children = parent.children()
        wait_for_end(processes, limit_s=0.0)
    assert not any(child.is_running() for child in [parent, *children])


def test_only_unmapped_shared_memory_is_removed() -> None:
    name = Path(f"/dev/shm/robbie-bench{os.getpid()}-test-of-names")
    name.write_bytes(bytes(4096))
    code = (
        "import mmap, sys; file = open(sys.argv[1], 'r+b'); memory = mmap.mmap(file.fileno(), 4096);"
        "print(flush=True); sys.stdin.read()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", code, str(name)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    with holder:
        present(holder.stdout).readline()
        assert mapped_names([holder.pid]) == {name}
        remove_unmapped([name])
        assert name.exists()
        present(holder.stdin).close()
    remove_unmapped([name])
    assert not name.exists()
