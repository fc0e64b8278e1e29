"""The folder of a run: private, locked as long as its supervisor lives."""

import fcntl
import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from robbie_mp.base.linux.proc import ProcessIdentity
from robbie_mp.bus.transport.shared_folder import remove_names
from robbie_mp.run import run_directory
from robbie_mp.run.run_directory import RunDirectory, UnsafeRunFolder, base_folders, list_runs, safe_folders
from robbie_mp.run.supervisor.sweep import dead_runs
from tests._support.own_runs import EVERY_BASE_FOLDER


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_new_run_is_private_and_live_and_has_a_record(tmp_path: Path) -> None:
    base = tmp_path / "robbie"
    run = RunDirectory.create("arena", tmp_path / "output", base)
    assert (mode(base), mode(run.folder)) == (0o700, 0o700)
    [found] = list_runs([base])
    assert (found.run_id, found.folder, found.is_live, found.record) == (
        run.run_id,
        run.folder,
        True,
        run.record,
    )
    assert json.loads((run.folder / "run.json").read_text())["profile"] == "arena"
    assert ProcessIdentity(run.record.supervisor_pid, run.record.supervisor_start_ticks).is_alive
    assert run.record.python == sys.executable
    assert run.record.output_directory == str(tmp_path / "output")
    run.remove()
    assert list_runs([base]) == []


def test_runs_have_unique_ids(tmp_path: Path) -> None:
    runs = [RunDirectory.create("arena", tmp_path, tmp_path / "robbie") for _ in range(5)]
    assert len({run.run_id for run in runs}) == 5
    assert {run.run_id for run in list_runs([tmp_path / "robbie"])} == {run.run_id for run in runs}
    for run in runs:
        run.remove()


def test_child_process_does_not_hold_the_lock(tmp_path: Path) -> None:
    run = RunDirectory.create("arena", tmp_path, tmp_path / "robbie")
    with subprocess.Popen(["sleep", "60"], close_fds=False) as child:
        for lock_fd in run._lock_fds:
            os.close(lock_fd)  # as the supervisor's death does
        assert [found.is_live for found in list_runs([tmp_path / "robbie"])] == [False]
        assert dead_runs([tmp_path / "robbie"]) == [run.run_id]
        child.kill()
    remove_names(run.run_id)


def test_run_takes_another_id_if_its_new_folder_is_removed_before_it_is_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a sweep, which finds a folder that nobody has locked."""
    flock, removed = fcntl.flock, list[Path]()

    def sweep_first(fd: int, operation: int) -> None:
        if not removed and (folders := list(tmp_path.glob("shm/robbie-*"))):
            folders[0].rmdir()
            removed.extend(folders)
        flock(fd, operation)

    monkeypatch.setattr(fcntl, "flock", sweep_first)
    (tmp_path / "shm").mkdir()
    run = RunDirectory.create("arena", tmp_path, tmp_path / "robbie", tmp_path / "shm")
    assert removed
    assert [path.name for path in (tmp_path / "shm").iterdir()] == [f"robbie-{run.run_id}"]
    assert removed[0].name != f"robbie-{run.run_id}"
    run.remove()
    assert not list((tmp_path / "shm").iterdir())


def test_run_whose_supervisor_died_early_is_listed_as_dead(tmp_path: Path) -> None:
    (tmp_path / "0123abcd").mkdir()
    (tmp_path / "ffff0000").mkdir()
    (tmp_path / "ffff0000" / "run.json").write_text('{"run_id": ')
    (tmp_path / "something else").mkdir()
    found = list_runs([tmp_path, tmp_path / "missing"])
    assert sorted((run.run_id, run.is_live, run.record) for run in found) == [
        ("0123abcd", False, None),
        ("ffff0000", False, None),
    ]


def test_record_of_another_version_is_none_or_is_read(tmp_path: Path) -> None:
    run = RunDirectory.create("arena", tmp_path / "output", tmp_path / "runs", tmp_path)
    record = json.loads((run.folder / "run.json").read_text())
    for number, other in enumerate(({"started_at": 5}, {"workspace": None}, {"is_robot": "no"})):
        folder = tmp_path / "runs" / f"ffff000{number}"
        folder.mkdir()
        (folder / "run.json").write_text(json.dumps(record | other))
    (run.folder / "run.json").write_text(json.dumps(record | {"new_in_the_next_version": 1}))
    listed = list_runs([tmp_path / "runs"])
    assert [one.record for one in listed] == [None, None, None, run.record]
    run.remove()


def test_folder_that_others_can_enter_is_refused(tmp_path: Path) -> None:
    base = tmp_path / "robbie"
    base.mkdir(mode=0o755)
    with pytest.raises(UnsafeRunFolder, match="mode 0755"):
        RunDirectory.create("arena", tmp_path, base)


def test_link_to_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    (tmp_path / "robbie").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UnsafeRunFolder, match="no directory"):
        RunDirectory.create("arena", tmp_path, tmp_path / "robbie")


def test_folder_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = tmp_path / "robbie"
    base.mkdir(mode=0o700)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(UnsafeRunFolder, match=f"belongs to user {os.getuid()}"):
        RunDirectory.create("arena", tmp_path, base)


def test_runtime_directory_is_preferred_if_it_is_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = Path(f"/tmp/robbie-{os.geteuid()}")
    monkeypatch.setattr(run_directory, "LOGIN_SESSIONS", tmp_path / "nobody is logged in")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert base_folders() == [tmp_path / "robbie", shared]
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "missing"))
    assert base_folders() == [shared]
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert base_folders() == [shared]


def test_runs_of_login_sessions_are_found_by_cron_and_by_system_services(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They have no XDG_RUNTIME_DIR, and started a second robot on the same motors."""
    session = tmp_path / str(os.geteuid())
    session.mkdir(mode=0o700)
    monkeypatch.setattr(run_directory, "LOGIN_SESSIONS", tmp_path)
    monkeypatch.setattr(run_directory, "base_folders", EVERY_BASE_FOLDER)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(session))
    run = RunDirectory.create("arena", tmp_path)
    assert run.folder == session / "robbie" / run.run_id
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert run.run_id in {found.run_id for found in list_runs()}
    run.remove()


def test_folder_that_others_can_write_to_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    run = RunDirectory.create("arena", tmp_path)
    base = run.folder.parent
    assert run.run_id in {found.run_id for found in list_runs()}
    base.chmod(0o770)
    assert base not in safe_folders()
    assert run.run_id not in {found.run_id for found in list_runs()}
    run.remove()
