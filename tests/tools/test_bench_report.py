"""Tables, goals and the page of benchmarks, from invented results."""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tools.bench import report
from tools.bench.goals import goal_table
from tools.bench.table import middle, ratio, table


def row(name: str, p50_us: Sequence[float | None], title: str = "", **others: Any) -> dict[str, Any]:
    return {
        "name": name,
        "title": title or name,
        "version": "1.0",
        "how": "somehow",
        "trouble": "",
        "rounds": list(range(len(p50_us))),
        "p50_us": p50_us,
        "p99_us": [value and 2 * value for value in p50_us],
        "sent": [100] * len(p50_us),
        "wanted": [100] * len(p50_us),
        "lost": [0] * len(p50_us),
        **others,
    }


ABSENT: dict[str, Any] = {
    "name": "lcm",
    "title": "LCM",
    "version": "",
    "how": "",
    "trouble": "not installed",
    "rounds": [],
}
LATENCY: dict[str, Any] = {
    "benchmark": "latency",
    "title": "64 bytes, 1 kHz, 1 subscriber",
    "kind": "latency",
    "reference": "robbie",
    "contenders": [
        row("floor", [40.0, 80.0]),
        row("robbie", [50.0, 96.0]),
        row("zeromq", [75.0, 75.0]),
        ABSENT,
    ],
}
MACHINE = {
    "date": "today",
    "processor": "one",
    "cores": 2,
    "memory_gib": 4.0,
    "kernel": "Linux",
    "python": "3.11",
    "load_before": 0.1,
}
RUN = {"machine": MACHINE, "command": "python -m tools.bench", "results": [LATENCY]}


def test_ratios_are_taken_within_each_round() -> None:
    floor, robbie, *_ = LATENCY["contenders"]
    assert ratio(robbie, floor, "p50_us") == pytest.approx((50 / 40 + 96 / 80) / 2)
    assert ratio(robbie, ABSENT, "p50_us") is None
    later = row("zeromq", [24.0], rounds=[1])
    assert ratio(robbie, later, "p50_us") == 96 / 24


def test_rounds_in_which_nothing_arrived_do_not_count() -> None:
    assert middle([None, 3.0, 5.0]) == 4.0
    assert middle([None]) is None


def test_table_names_absent_contenders_with_the_reason() -> None:
    lines = table(LATENCY).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[2].split("|")[2].strip() == "60.0"
    assert "LCM: not installed" in lines[-1]


def test_goals_compare_with_the_floor_and_the_best_peer() -> None:
    text = goal_table([LATENCY])
    floor, peer = (line.split("|") for line in text.splitlines()[2:4])
    assert (floor[3].strip(), floor[5].strip()) == ("1.23", "yes")
    assert (peer[3].strip(), peer[4].strip(), peer[5].strip()) == ("0.97", "zeromq", "no")


def test_goals_that_were_not_measured_are_left_out() -> None:
    assert "flat out" not in goal_table([LATENCY])


def test_report_replaces_the_text_between_the_marker_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []
    monkeypatch.setattr(report, "draw", lambda results, file: drawn.append(file))
    page = tmp_path / "benchmarks.md"
    page.write_text(f"before\n{report.BEGIN}\nold\n{report.END}\nafter\n")
    for _ in range(2):
        report.write_report(RUN, tmp_path)
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("\nafter\n")
    assert "old" not in text
    assert text.count("### latency: 64 bytes") == 1
    assert "python -m tools.bench" in text
    assert drawn[0] == tmp_path / "images" / "benchmarks.png"


def test_page_without_marker_lines_is_not_changed(tmp_path: Path) -> None:
    (tmp_path / "benchmarks.md").write_text("nothing")
    with pytest.raises(report.NoPlaceForResults):
        report.write_report(RUN, tmp_path)
    assert (tmp_path / "benchmarks.md").read_text() == "nothing"


def test_page_and_picture_are_written_from_stored_results(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    rates = {
        "benchmark": "throughput",
        "title": "flat out",
        "kind": "throughput",
        "contenders": [row("robbie", [1.0], received_per_s=[5000.0]), ABSENT],
    }
    (tmp_path / "benchmarks.md").write_text(f"{report.BEGIN}\n{report.END}\n")
    kept = tmp_path / "results.json"
    kept.write_text(json.dumps(RUN | {"results": [LATENCY, rates]}))
    # In a separate process, because matplotlib keeps fonts open.
    command = [sys.executable, "-m", "tools.bench", "--read", str(kept), "--report", str(tmp_path)]
    subprocess.run(command, check=True)
    assert "flat out" in (tmp_path / "benchmarks.md").read_text()
    assert (tmp_path / "images" / "benchmarks.png").read_bytes().startswith(b"\x89PNG")
