"""The examination checks this machine, and a profile's needs are those of its run."""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.base.extras import own_requirements
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names
from robbie_mp.cli import main
from robbie_mp.run.doctor.clock import clock_state
from robbie_mp.run.doctor.examination import examine, guarded, worst
from robbie_mp.run.doctor.finding import Finding, Level, fail, ok, warn
from robbie_mp.run.doctor.memory import probe_shared_memory
from robbie_mp.run.doctor.needs import Needs, segments
from robbie_mp.run.doctor.permissions import check_run_folder, login_setting
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.model import MemoryLimits, ModuleSpec, Profile
from robbie_mp.run.run_directory import lock_folder
from robbie_mp.run.supervisor.memory import RunMemory
from robbie_mp.run.supervisor.own_history import AT_FIRST_BYTES
from robbie_mp.run.supervisor.sweep import sweep

PROFILE = """
modules:
  whole: {class: "sound:Sound"}
  broken: {class: "broken:Broken"}
"""


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "profiles").mkdir()
    (tmp_path / "profiles" / "robot.yaml").write_text(PROFILE)
    (tmp_path / "sound.py").write_text(
        "from robbie_mp.module.module import Module\nclass Sound(Module): pass\n"
    )
    (tmp_path / "broken.py").write_text("import no_such_package\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_module_that_cannot_be_imported_fails(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "robot", "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["level"] == "fail"
    assert [finding for finding in report["findings"] if finding["level"] == "fail"] == [
        {
            "check": "modules",
            "level": "fail",
            "found": "broken cannot be imported: ModuleNotFoundError: No module named 'no_such_package' "
            "(broken.py:1)",
            "advice": "install what is missing",
        }
    ]


def test_machine_that_runs_these_tests_passes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("ok    kernel: linux ")
    assert lines[-1].endswith("0 fail")


def test_wrong_profile_is_bad_usage(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (workspace / "profiles" / "robot.yaml").write_text("modules: {whole: {class: 'sound:Silence'}}")
    assert main(["doctor", "robot"]) == 2
    assert "has no class 'Silence'" in capsys.readouterr().err


def test_failing_check_is_a_finding_and_does_not_end_the_others() -> None:
    def look() -> Iterator[Finding]:
        yield ok("first", "well")
        raise PermissionError(13, "Permission denied", "/sys/kernel")

    findings = guarded("kernel", look)
    assert [finding.level for finding in findings] == [Level.OK, Level.WARN]
    assert "Permission denied" in findings[1].found


def test_broken_machine_is_reported_without_a_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_arguments: object, **_named: object) -> None:
        raise OSError("no such thing here")

    for name in ("resource.getrlimit", "os.sched_getaffinity", "os.geteuid", "psutil.virtual_memory",
                 "time.get_clock_info", "os.pidfd_open", "platform.release"):  # fmt: skip
        monkeypatch.setattr(name, broken)
    monkeypatch.setattr("robbie_mp.run.doctor.memory.secrets.token_hex", lambda _size: "d0c0b0b0")
    findings = examine()
    monkeypatch.undo()
    remove_names("d0c0b0b0")  # without os.geteuid it could not tell that they are its own
    assert len([finding for finding in findings if "no such thing here" in finding.found]) >= 6


def test_worst_level_counts() -> None:
    assert worst([]) is Level.OK
    assert worst([ok("a", "b"), warn("a", "b", "c")]) is Level.WARN
    assert worst([fail("a", "b", "c"), ok("a", "b")]) is Level.FAIL


def test_estimated_memory_at_the_start_is_that_of_a_run() -> None:
    modules = tuple(ModuleSpec(name, "zoo:Idle") for name in ("one", "two"))
    plan = RunPlan.of_profile(Profile("p", modules), "d0c7d0c7", Path(), Path(), os.getpid())
    make_folder("d0c7d0c7")
    memory = RunMemory(plan)
    for name in ("core", "one", "two"):
        memory.open(name, 1)
    taken = sum(file.stat().st_size for file in SHARED_MEMORY.glob("robbie-d0c7d0c7/*"))
    memory.close()
    needs = Needs.of(Profile("p", modules))
    first_messages = 2 * (MemoryLimits().segment_bytes + AT_FIRST_BYTES) + (64 << 10)
    assert needs.start_bytes == taken + first_messages


def test_segments_double_in_size_up_to_the_limit() -> None:
    assert segments(MemoryLimits(1 << 20, 1 << 20)) == 1
    assert segments(MemoryLimits(1 << 20, 7 << 20)) == 3
    assert segments(MemoryLimits(1 << 20, 256 << 20)) == 9


def test_run_folder_must_belong_to_this_user_alone(tmp_path: Path) -> None:
    assert check_run_folder(tmp_path / "robbie", None).level is Level.OK
    assert check_run_folder(tmp_path / "missing" / "robbie", None).level is Level.FAIL
    shared = tmp_path / "shared"
    shared.mkdir(mode=0o777)
    shared.chmod(0o777)
    assert "0777" in check_run_folder(shared, None).found
    private = tmp_path / "private"
    private.mkdir(mode=0o700)
    assert check_run_folder(private, str(tmp_path)).level is Level.OK
    assert check_run_folder(private, "/run/user/12345").level is Level.WARN


def test_last_setting_of_logind_counts(tmp_path: Path) -> None:
    assert login_setting("RemoveIPC", [str(tmp_path)]) is None
    (tmp_path / "logind.conf").write_text("[Login]\n#RemoveIPC=yes\nRemoveIPC = no\n")
    assert login_setting("RemoveIPC", [str(tmp_path)]) == "no"
    (tmp_path / "logind.conf.d").mkdir()
    (tmp_path / "logind.conf.d" / "50-site.conf").write_text("[Login]\nRemoveIPC=yes\n")
    assert login_setting("RemoveIPC", [str(tmp_path)]) == "yes"


def test_clock_is_read_and_not_set() -> None:
    assert clock_state() in range(6)


def test_requirements_are_those_of_the_project() -> None:
    found = {(requirement.package, requirement.extra) for requirement in own_requirements()}
    assert {("numpy", ""), ("msgspec", ""), ("scipy", "robot"), ("pytest", "dev")} <= found


def test_probe_of_shared_memory_leaves_nothing() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robbie_mp.run.doctor.memory.secrets.token_hex", lambda _size: "d0c0d0c0")
        assert probe_shared_memory() == ""
        assert not list(SHARED_MEMORY.glob("*d0c0d0c0*"))
        make_folder("d0c0d0c0")
        assert "File exists" in probe_shared_memory(), "the probe looks elsewhere"
        remove_names("d0c0d0c0")


def test_remains_of_a_killed_probe_are_swept(tmp_path: Path) -> None:
    run_id = "0d0c0d0c"
    (tmp_path / f"robbie-{run_id}").mkdir(mode=0o700)
    names = {f"robbie-{run_id}/board"}
    for name in names:
        (tmp_path / name).touch(mode=0o600)
    lock_fd = lock_folder(tmp_path / f"robbie-{run_id}")
    assert lock_fd is not None
    assert sweep([], tmp_path).names == (), "it is just at work"
    os.close(lock_fd)
    assert set(sweep([], tmp_path).names) == names | {f"robbie-{run_id}"}
