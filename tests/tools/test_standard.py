"""The standard comparison: one table, and no figures of a machine that others use."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.tools.test_bench_report import row
from tools.bench import machine, standard
from tools.bench.__main__ import main
from tools.bench.machine import NotComparable, ProcessorTimes, QuietMachine
from tools.bench.standard_table import standard_table
from tools.busy import busy


@pytest.fixture
def any_machine_is_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "OTHERS_LIMIT", 2.0)
    monkeypatch.setattr(machine, "STEAL_LIMIT", 2.0)
    monkeypatch.setattr(machine, "SPEED_LIMIT", 0.0)


def latency(title: str, *rows: dict[str, Any]) -> dict[str, Any]:
    return {"benchmark": "latency", "title": title, "kind": "latency", "contenders": list(rows)}


def failed(name: str, trouble: str) -> dict[str, Any]:
    return {"name": name, "title": name, "version": "", "trouble": trouble, "rounds": []}


def cells(table: str, beginning: str) -> list[str]:
    line = next(line for line in table.splitlines() if line.startswith(f"| {beginning}"))
    return [cell.strip() for cell in line.strip("|").split("|")[1:]]


def test_table_compares_with_the_floor_and_the_best_peer() -> None:
    rows = [row("memcpy", [10.0]), row("robbie", [50.0]), row("zeromq", [80.0]), row("lcm", [100.0])]
    table = standard_table([latency("1 kB", *rows)])
    assert cells(table, "1 kB: p50") == ["10", "50", "80", "100", "5.00", "0.62"]
    assert "p99 µs" not in table, "of 100 messages, it is the second worst"


def test_ratios_are_the_median_of_those_within_each_round() -> None:
    rows = [row("robbie", [20.0, 50.0, 90.0]), row("lcm", [10.0, 100.0, 180.0])]
    assert cells(standard_table([latency("1 kB", *rows)]), "1 kB: p50") == ["50", "100", "", "0.50"]


def test_table_shows_no_figure_of_a_busy_machine_and_says_why() -> None:
    busy_row = failed("zeromq", str(NotComparable("other programs used 43 % of the processors")))
    rows = [row("robbie", [50.0]), busy_row, failed("lcm", "lcm is not installed")]
    table = standard_table([latency("64 B", *rows)])
    assert cells(table, "64 B: p50") == ["50", "not comparable", "", ""]
    assert "- zeromq: not comparable: other programs used 43 % of the processors" in table
    assert "- lcm: lcm is not installed" in table


def test_nothing_is_measured_while_others_use_the_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "PATIENCE_S", 0.0)
    quiet = QuietMachine()
    with busy(4), pytest.raises(NotComparable, match=r"^not comparable: other programs used \d+% of"):
        quiet(lambda: pytest.fail("it was measured"))


def times(*stolen_s: float) -> Iterator[ProcessorTimes]:
    for number, stolen in enumerate(stolen_s):
        yield ProcessorTimes(total_s=float(number), used_s=0.0, stolen_s=stolen)


def test_measurement_does_not_count_if_the_host_took_the_processors_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(machine, "spin_s", lambda: 1.0)
    monkeypatch.setattr(machine, "ATTEMPTS", 1)
    looks = times(0.0, 0.0, 0.0, 0.5, 0.5, 0.5)
    monkeypatch.setattr(ProcessorTimes, "now", lambda: next(looks))
    with pytest.raises(NotComparable, match="other virtual machines took 50% of the processors"):
        QuietMachine()(lambda: "measured")


def test_disturbed_measurement_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "spin_s", lambda: 1.0)
    disturbed, undisturbed = [0.0, 0.0, 0.0, 0.5], [0.5] * 6
    looks = times(*disturbed, *undisturbed)
    monkeypatch.setattr(ProcessorTimes, "now", lambda: next(looks))
    measured = iter(["disturbed", "undisturbed"])
    assert QuietMachine()(lambda: next(measured)) == "undisturbed"


def test_nothing_is_repeated_when_the_time_for_it_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "PATIENCE_S", 0.0)
    monkeypatch.setattr(machine, "REPEATS_S", -1.0)
    looks = iter(["busy"])
    monkeypatch.setattr(QuietMachine, "disturbance", lambda self: next(looks))
    with pytest.raises(NotComparable):
        QuietMachine()(lambda: pytest.fail("it was measured"))


def test_processor_that_is_clocked_down_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    spins = iter([1.0, 2.0])
    monkeypatch.setattr(machine, "spin_s", lambda: next(spins))
    looks = times(0.0, 0.0)
    monkeypatch.setattr(ProcessorTimes, "now", lambda: next(looks))
    assert QuietMachine().disturbance() == "the processor ran at 50% of its speed"


def test_benchmarks_beside_standard_are_a_clear_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--standard", "latency"])
    assert "--standard measures all it needs; leave out latency" in capsys.readouterr().err


@pytest.mark.usefixtures("any_machine_is_quiet")
def test_standard_comparison_measures_all_kinds_of_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standard, "CASES", (standard.CASES[0], standard.CASES[4]))
    file = tmp_path / "results.json"
    few = ["--quick", "--only=floor,memcpy,robbie", "--count=10", "--seconds=0.3", "--modules=2"]
    assert main(["--standard", *few, "--json", str(file)]) == 0
    printed = capsys.readouterr().out
    for line in ("64 bytes, 1 kHz, 1 subscriber: p50", "64 kB", "2 idle modules", "SIGKILL to next message"):
        assert float(cells(printed, line)[1].replace(",", "")) > 0, printed
    run = json.loads(file.read_text())
    assert run["standard"] and len(run["results"]) == 6
