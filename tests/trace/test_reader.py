"""What the files of a trace say, in the right order, however they are cut."""

from pathlib import Path

from robbie_mp.profile.model import TraceSettings
from robbie_mp.supervisor.output import OutputStore
from robbie_mp.trace.reader import entries, last_entries, module_names


def write(output_directory: Path, count: int) -> None:
    limits = TraceSettings(file_bytes=4096, files=3, lines_per_s=1e9, burst_lines=10_000)
    store = OutputStore(output_directory / "log", limits=limits)
    modules = [store.child("laser"), store.child("mapping")]
    for number in range(count):
        modules[number % 2].add("stdout", [f"line {number}"])
    for module in modules:
        module.close()
    store.close()


def test_entries_of_all_modules_come_in_the_order_they_were_heard(tmp_path: Path) -> None:
    write(tmp_path, 30)
    assert [entry.text for entry in entries(tmp_path)] == [f"line {number}" for number in range(30)]
    assert [entry.text for entry in entries(tmp_path, ["laser"])] == [
        f"line {number}" for number in range(0, 30, 2)
    ]
    assert module_names(tmp_path) == ["laser", "mapping"]


def test_last_entries_are_found_across_rotated_files(tmp_path: Path) -> None:
    write(tmp_path, 1000)
    assert (tmp_path / "log" / "laser.2.jsonl").exists()
    kept = [entry.text for entry in entries(tmp_path, ["laser"])]
    assert kept[-1] == "line 998"
    assert len(kept) < 500
    for count in (1, 3, 40, len(kept), len(kept) + 1):
        assert [entry.text for entry in last_entries(tmp_path, "laser", count)] == kept[-count:]


def test_half_a_line_of_a_killed_supervisor_is_passed_over(tmp_path: Path) -> None:
    write(tmp_path, 4)
    file = tmp_path / "log" / "laser.jsonl"
    file.write_bytes(file.read_bytes()[:-20])
    assert [entry.text for entry in last_entries(tmp_path, "laser", 5)] == ["line 0"]
    assert [entry.text for entry in entries(tmp_path)] == ["line 0", "line 1", "line 3"]


def test_nothing_recorded_is_nothing_read(tmp_path: Path) -> None:
    assert last_entries(tmp_path, "laser", 5) == []
    assert list(entries(tmp_path)) == []
