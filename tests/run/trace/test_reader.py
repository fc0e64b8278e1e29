"""The files of a trace are read in the right order, even if they are cut."""

import random
from pathlib import Path

from robbie_mp.run.profile.model import TraceSettings
from robbie_mp.run.supervisor.output import OutputStore
from robbie_mp.run.trace.crash import CrashReport, LastMessage, LastWords
from robbie_mp.run.trace.reader import TraceFollower, crash_reports, entries, last_entries, module_names


def write(output_directory: Path, count: int) -> None:
    limits = TraceSettings(file_bytes=4096, files=3, lines_per_s=1e9, burst_lines=10_000)
    store = OutputStore(output_directory / "log", limits=limits)
    modules = [store.child("laser"), store.child("mapping")]
    for number in range(count):
        modules[number % 2].add("stdout", [f"line {number}"])
    for module in modules:
        module.close()
    store.close()


def test_entries_of_all_modules_are_in_the_order_of_arrival(tmp_path: Path) -> None:
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


def test_incomplete_line_of_a_killed_supervisor_is_skipped(tmp_path: Path) -> None:
    write(tmp_path, 4)
    file = tmp_path / "log" / "laser.jsonl"
    file.write_bytes(file.read_bytes()[:-20])
    assert [entry.text for entry in last_entries(tmp_path, "laser", 5)] == ["line 0"]
    assert [entry.text for entry in entries(tmp_path)] == ["line 0", "line 1", "line 3"]


def test_empty_trace_has_no_entries(tmp_path: Path) -> None:
    assert last_entries(tmp_path, "laser", 5) == []
    assert list(entries(tmp_path)) == []


def test_follower_reads_each_entry_once_while_files_rotate(tmp_path: Path) -> None:
    limits = TraceSettings(file_bytes=4096, files=20, lines_per_s=1e9, burst_lines=1_000_000)
    store = OutputStore(tmp_path / "log", limits=limits)
    modules = [store.child("laser"), store.child("mapping")]
    follower = TraceFollower(tmp_path)
    chance = random.Random(7)
    written: list[str] = []
    read: list[str] = []
    for _ in range(300):
        lines = [f"line {len(written) + number}" for number in range(chance.randrange(40))]
        chance.choice(modules).add("stdout", lines)
        written += lines
        if chance.random() < 0.5:
            store.flush()
            read += [entry.text for entry in follower.read_new()]
            assert read == written
    for module in modules:
        module.close()
    store.close()
    assert (tmp_path / "log" / "laser.2.jsonl").exists()


def test_follower_waits_for_the_rest_of_a_line(tmp_path: Path) -> None:
    write(tmp_path, 3)
    file = tmp_path / "log" / "laser.jsonl"
    whole = file.read_bytes()
    file.write_bytes(whole[:-20])
    follower = TraceFollower(tmp_path, ["laser"])
    assert [entry.text for entry in follower.read_new()] == ["line 0"]
    with file.open("ab") as appended:
        appended.write(whole[-20:])
    assert [entry.text for entry in follower.read_new()] == ["line 2"]
    assert follower.read_new() == []


def report(module: str, incarnation: int) -> CrashReport:
    message = LastMessage("geometry_msgs/msg/Point", "front", 8, "source", 0.1)
    return CrashReport(
        module=module,
        incarnation=incarnation,
        pid=7,
        time_s=1.7e9 + incarnation,
        uptime_s=3.0,
        reason="killed by SIGSEGV",
        exit_code=None,
        signal=11,
        cpu_s=0.5,
        hints=["memory was full"],
        last_words=LastWords("tick", 1.0, message, {"handled": 5}, "all\x1bwell"),
        said=["a", "Traceback (most recent call last):", "x", "Fatal Python error: Aborted", "stack"],
        printed=["b"],
    )


def test_reports_are_read_back_and_only_the_newest_are_kept(tmp_path: Path) -> None:
    store = OutputStore(tmp_path / "log", limits=TraceSettings(crash_reports=3))
    for incarnation in range(1, 6):
        for module in ("laser", "laser-front"):
            place = store.write_report(report(module, incarnation), lambda is_done: None)
            assert place.startswith(f"crashes/{module}-2023")
    store.close()
    assert crash_reports(tmp_path, "laser") == [report("laser", number) for number in (3, 4, 5)]
    assert crash_reports(tmp_path, "laser-front", newest=1) == [report("laser-front", 5)]
    assert crash_reports(tmp_path, newest=0) == []
    assert [found.incarnation for found in crash_reports(tmp_path)] == [3, 3, 4, 4, 5, 5]
    assert len(list((tmp_path / "log" / "crashes").iterdir())) == 6


def test_printed_report_is_complete_and_escapes_control_characters() -> None:
    made = report("laser", 2)
    assert made.traceback == ["Fatal Python error: Aborted", "stack"]
    text = "\n".join(made.lines())
    for part in (
        "SIGSEGV",
        "memory was full",
        "tick",
        "Point on front, number 8",
        "source",
        "handled 5",
        "    x",
    ):
        assert part in text
    assert "all\\x1bwell" in text


def test_refused_report_blocks_nothing(tmp_path: Path) -> None:
    store = OutputStore(tmp_path / "log")
    (tmp_path / "log" / "crashes").touch()
    answers: list[bool] = []
    store.write_report(report("laser", 1), answers.append)
    store.close()
    assert answers == [False]
