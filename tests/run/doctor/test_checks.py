"""Each check judges machines that are suitable, that could be better, and on which no robot can run."""

import re
import resource
from collections.abc import Iterable
from dataclasses import replace

import pytest

from robbie_mp.base.extras import Requirement
from robbie_mp.run.doctor import clock, kernel, limits, memory, permissions, processor, python, runs
from robbie_mp.run.doctor.finding import Finding, Level, size
from robbie_mp.run.doctor.needs import Needs

OK, WARN, FAIL = Level.OK, Level.WARN, Level.FAIL
MIB, GIB = 1 << 20, 1 << 30
UNLIMITED = resource.RLIM_INFINITY
NEEDS = Needs(
    profile="rover",
    start_bytes=10 * MIB,
    limit_bytes=GIB,
    largest_file_bytes=256 * MIB,
    processes=7,
    descriptors_to_start=80,
    descriptors=200,
)

CASES: dict[Level, list[Finding]] = {
    OK: [
        memory.check_usable(""),
        memory.check_shared_memory(2 * GIB, GIB, None),
        memory.check_shared_memory(2 * GIB, GIB, NEEDS),
        memory.check_working_memory(MIB, None),
        memory.check_working_memory(2 * GIB, NEEDS),
        memory.check_swap(0, 0),
        memory.check_swap(8 * GIB, MIB),
        memory.check_disk(GIB, is_writable=True),
        limits.check_descriptors(UNLIMITED, NEEDS),
        limits.check_descriptors(200, NEEDS),
        limits.check_descriptors(1024, None),
        limits.check_processes(UNLIMITED, 10000, 64, NEEDS),
        limits.check_processes(100 + 7 * 4, 100, 4, NEEDS),
        limits.check_file_size(UNLIMITED, None),
        limits.check_file_size(256 * MIB, NEEDS),
        limits.check_pids(None, None),
        limits.check_pids(32768, None),
        limits.check_optional(0, 0, NEEDS),
        limits.check_optional(0, 10, replace(NEEDS, realtime_priority=10)),
        limits.check_system_v(None, None),
        clock.check_monotonic(1e-9, 5e-8),
        clock.check_source(None),
        clock.check_source("tsc"),
        clock.check_synchronised(None),
        clock.check_synchronised(0),
        processor.check_count(2, None),
        processor.check_count(4, "max 100000"),
        processor.check_count(4, "garbage"),
        processor.check_governor({}, None),
        processor.check_governor({"schedutil": 4}, "acpi-cpufreq"),
        processor.check_governor({"powersave": 4}, "intel_pstate"),
        processor.check_wake_latency(may_limit=False, needs=NEEDS),
        processor.check_wake_latency(may_limit=True, needs=replace(NEEDS, limits_wake_latency=True)),
        kernel.check_release("linux", "5.4.0-generic"),
        kernel.check_release("linux", "6.12"),
        kernel.check_machine("little", 2**63 - 1, "aarch64"),
        kernel.check_calls({"pidfd_open": ""}),
        kernel.check_proc(has_stat=True, has_tasks=True),
        python.check_version((3, 11), "cpython", is_gil_enabled=True),
        python.check_hot_path(""),
        permissions.check_serial_ports({}, "dialout", frozenset()),
        permissions.check_serial_ports({"/dev/ttyUSB0": True}, "dialout", frozenset()),
        permissions.check_removal(1000, "no", lingers=False),
        permissions.check_removal(1000, None, lingers=True),
        permissions.check_removal(0, None, lingers=False),
        runs.check_runs(0, []),
        runs.check_runs(2, []),
        python.check_modules(3, {}),
        python.check_capsules([], 3),
        python.check_capsules(["laser"], 3),
    ],
    WARN: [
        limits.check_optional(0, 9, replace(NEEDS, realtime_priority=10)),
        memory.check_shared_memory(64 * MIB, 64 * MIB, None),
        memory.check_shared_memory(GIB, GIB - 1, NEEDS),
        memory.check_working_memory(GIB, NEEDS),
        memory.check_swap(8 * GIB, GIB),
        memory.check_disk(GIB - 1, is_writable=True),
        memory.check_disk(GIB, is_writable=False),
        limits.check_descriptors(199, NEEDS),
        limits.check_descriptors(256, None),
        limits.check_processes(100 + 7 * 4 - 1, 100, 4, NEEDS),
        limits.check_pids(4000, None),
        limits.check_pids(32768, 1024),
        clock.check_monotonic(4e-3, 5e-8),
        clock.check_monotonic(1e-9, 3e-6),
        clock.check_source("hpet"),
        clock.check_synchronised(clock.TIME_ERROR),
        processor.check_count(1, None),
        processor.check_count(8, "150000 100000"),
        processor.check_governor({"performance": 2, "powersave": 2}, "acpi-cpufreq"),
        processor.check_wake_latency(may_limit=False, needs=replace(NEEDS, limits_wake_latency=True)),
        python.check_version((3, 13), "cpython", is_gil_enabled=False),
        python.check_version((3, 11), "pypy", is_gil_enabled=True),
        python.check_hot_path("it was not built; install gcc"),
        permissions.check_serial_ports({"/dev/ttyACM0": False}, "dialout", frozenset({"users"})),
        permissions.check_serial_ports({"/dev/ttyACM0": False}, "dialout", frozenset({"dialout"})),
        permissions.check_removal(1000, None, lingers=False),
        permissions.check_removal(1000, "Yes", lingers=False),
        runs.check_runs(0, ["01234567"]),
    ],
    FAIL: [
        memory.check_usable("Permission denied"),
        memory.check_shared_memory(64 * MIB, 10 * MIB - 1, NEEDS),
        memory.check_working_memory(100 * MIB, NEEDS),
        limits.check_descriptors(79, NEEDS),
        limits.check_processes(106, 100, 4, NEEDS),
        limits.check_file_size(MIB, NEEDS),
        limits.check_file_size(MIB, None),
        limits.check_pids(32768, 100),
        kernel.check_release("linux", "5.3.18"),
        kernel.check_release("linux", "4.19.0-rpi"),
        kernel.check_release("darwin", "23.1.0"),
        kernel.check_release("linux", "nonsense"),
        kernel.check_machine("big", 2**63 - 1, "s390x"),
        kernel.check_machine("little", 2**31 - 1, "armv7l"),
        kernel.check_calls({"pidfd_open": "Function not implemented", "prctl": ""}),
        kernel.check_proc(has_stat=False, has_tasks=True),
        python.check_version((3, 9), "cpython", is_gil_enabled=True),
        python.check_modules(3, {"mapping": "Traceback\nModuleNotFoundError: No module named 'scipy'\n"}),
        python.check_modules(3, {"mapping": ""}),
    ],
}


@pytest.mark.parametrize("level", Level)
def test_machines_are_judged_correctly(level: Level) -> None:
    assert [finding for finding in CASES[level] if finding.level is not level] == []


def test_missing_libraries_are_advised_by_their_extras() -> None:
    missing = {
        name: f"ModuleNotFoundError: No module named '{name}'" for name in ("PIL", "serial", "cv2", "x")
    }
    advice = python.check_modules(4, missing).advice
    assert re.findall("the extra `.*?`: pip install '|install what is missing", advice) == [
        "the extra `robot`: pip install '",
        "the extra `vision`: pip install '",
        "install what is missing",
    ]


def test_problems_have_advice_and_other_lines_have_none() -> None:
    findings = [finding for level in Level for finding in CASES[level]]
    assert [finding for finding in findings if bool(finding.advice) is (finding.level is OK)] == []
    assert [finding for finding in findings if not finding.found] == []


def test_advice_on_shared_memory_names_a_sufficient_size() -> None:
    total, free = 64 * MIB, 60 * MIB
    advice = memory.check_shared_memory(total, free, replace(NEEDS, limit_bytes=GIB)).advice
    assert "size=1028m" in advice  # what is needed, and the 4 MiB that others have


def packages(installed: dict[str, str | None]) -> dict[str, tuple[Level, str]]:
    texts = ["numpy>=1.26", 'scipy>=1.11 ; extra == "robot"', "pillow>=10.0; extra == 'robot'"]
    requirements = [Requirement.parse(text) for text in [*texts, 'rosbags; extra == "ros"']]
    found: Iterable[Finding] = python.check_packages(requirements, {"rosbags": None, **installed})
    return {finding.check: (finding.level, finding.found) for finding in found}


NEW: dict[str, str | None] = {"numpy": "2.0", "scipy": "1.11", "pillow": "10.0.1"}


def test_extras_take_one_line_and_only_old_packages_one_more() -> None:
    whole = (OK, "all are installed")
    assert packages(NEW) == {"packages": whole, "extras": (OK, "installed: robot; not installed: ros")}
    half = packages({**NEW, "scipy": None, "pillow": "9"})
    assert half == {"packages": whole, "extras": (OK, "installed: none; not installed: robot, ros")}
    old = packages({**NEW, "scipy": "1.9"})
    assert old["extra robot"] == (WARN, "too old: scipy 1.9 (needs 1.11)")


def test_missing_packages_of_robbie_itself_are_a_failure() -> None:
    assert packages({**NEW, "numpy": None})["packages"] == (FAIL, "missing: numpy")
    assert packages({**NEW, "numpy": "1.9.3"})["packages"][0] is FAIL


def test_sizes_are_readable() -> None:
    assert [size(count) for count in (0, 5, 1536, 64 * MIB, 1.5 * GIB, 3 << 40)] == [
        "0 B", "5 B", "1.5 KiB", "64 MiB", "1.5 GiB", "3.0 TiB",
    ]  # fmt: skip
