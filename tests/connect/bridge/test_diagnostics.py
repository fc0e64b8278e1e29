"""What a robot tells the tools of ROS of itself."""

import json
from pathlib import Path
from typing import Any

import pytest
from rosbags.typesys import Stores, get_typestore

from robbie_mp.connect.bridge.diagnostics import DIAGNOSTICS, MAX_LINES, Diagnosis, TraceLines, log_line
from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.messages import Log, ModuleProfile, SystemProfile, Time
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.reader import trace_folder

PUBLISHED = json.loads((Path(__file__).parents[1] / "ros2" / "published_type_hashes.json").read_text())
ROS = get_typestore(Stores.ROS2_JAZZY)


def entry(number: int = 1, **fields: Any) -> Entry:
    common = {"time_s": 1.5, "kind": Kind.WARNING, "module": "laser", "incarnation": 1, "stream": "log"}
    return Entry(**{"number": number, "text": "no data", **common, **fields})


def read(diagnosis: Diagnosis, *modules: ModuleProfile, **fields: Any) -> list[Any]:
    """Return the statuses, decoded by rosbags."""
    data = diagnosis.of(SystemProfile(stamp=Time(sec=5), modules=list(modules), **fields)).encode()
    array: Any = ROS.deserialize_cdr(data, DIAGNOSTICS.type_name)
    assert array.header.stamp.sec == 5
    return list(array.status)


def test_diagnostics_are_the_type_that_ros_uses() -> None:
    assert type_hash(DIAGNOSTICS) == PUBLISHED[DIAGNOSTICS.type_name]


def test_entry_of_the_trace_becomes_a_log_line() -> None:
    line = log_line(entry(logger="laser", level="WARNING", where="laser.py:12", traceback="Traceback"))
    assert (line.level, line.name, line.msg) == (Log.WARN, "laser", "no data\nTraceback")
    assert (line.file, line.line, line.stamp.nanoseconds) == ("laser.py", 12, 1_500_000_000)
    assert log_line(entry(logger="urllib3", where="nowhere")).name == "laser.urllib3"
    assert log_line(entry(kind=Kind.ERROR, level="CRITICAL")).level == Log.FATAL
    assert log_line(entry(kind=Kind.SYSTEM)).level == Log.DEBUG


def test_only_new_entries_are_sent_and_a_flood_is_cut_and_counted(tmp_path: Path) -> None:
    folder = trace_folder(tmp_path)
    folder.mkdir()
    with (folder / "laser.jsonl").open("ab", buffering=0) as file:
        file.write(entry(text="old").to_line())
        lines = TraceLines(tmp_path)
        assert not list(lines.read_new())
        for number in range(MAX_LINES + 3):
            file.write(entry(number, text=f"line {number}").to_line())
        found = list(lines.read_new())
    assert (len(found), found[0].msg, lines.skipped) == (MAX_LINES, "line 3", 3)


@pytest.mark.parametrize(("state", "level"), [("RUNNING", 0), ("STARTING", 1), ("BACKOFF", 2), ("FAILED", 2)])
def test_state_of_a_module_is_the_level_of_its_status(state: str, level: int) -> None:
    machine, status = read(Diagnosis("red", "run7"), ModuleProfile(name="laser", state=state, pid=12))
    assert (machine.name, machine.level, machine.message) == ("red: machine", 0, "OK")
    assert (status.name, status.level, status.message) == ("red: laser", level, state)
    assert status.hardware_id == "run7"
    assert {one.key: one.value for one in status.values}["pid"] == "12"


def test_restart_since_the_last_time_and_trouble_are_warnings() -> None:
    diagnosis = Diagnosis("red", "run7")
    running: dict[str, Any] = {"name": "laser", "state": "RUNNING"}
    assert read(diagnosis, ModuleProfile(**running, restarts=4))[1].level == 0
    _, status = read(diagnosis, ModuleProfile(**running, restarts=5, health="it is unplugged"))
    assert (status.level, status.message) == (1, "RUNNING, restarted, it is unplugged")
    _, status = read(diagnosis, ModuleProfile(**running, restarts=5, health="it is unplugged"))
    assert (status.level, status.message) == (1, "RUNNING, it is unplugged")
    assert read(diagnosis, ModuleProfile(**running, restarts=5))[1].level == 0


def test_full_memory_is_a_warning() -> None:
    (machine,) = read(Diagnosis("red", "run7"), memory_available_bytes=1, memory_total_bytes=100)
    assert (machine.level, machine.message) == (1, "memory is nearly full")
