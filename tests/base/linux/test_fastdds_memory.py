"""What killed participants of FastDDS left in shared memory is removed, and what lives is not."""

import fcntl
import mmap
import os
from pathlib import Path

import pytest

from robbie_mp.base.linux.fastdds_memory import YOUNG_S, remove_dead_participants

SEGMENT = "fastrtps_0108bac15c66191d"
PORT = "fastdds_port70000"
"""No participant has it: ports end at 65535. One that another program has mapped would stay."""


def make(folder: Path, *names: str, age_s: float = 0.0) -> list[str]:
    for name in names:
        (folder / name).write_bytes(bytes(64))
        changed_s = (folder / name).stat().st_mtime - age_s
        os.utime(folder / name, (changed_s, changed_s))
    return sorted(names)


def test_files_whose_lock_nobody_holds_are_removed_with_their_mutex(tmp_path: Path) -> None:
    made = make(tmp_path, SEGMENT, f"{SEGMENT}_el", PORT, f"{PORT}_sl", f"sem.{PORT}_mutex")
    assert sorted(remove_dead_participants(tmp_path)) == made
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", ["_el", "_sl"])
def test_files_whose_lock_is_held_stay(tmp_path: Path, suffix: str) -> None:
    make(tmp_path, PORT, f"{PORT}{suffix}", f"sem.{PORT}_mutex")
    with (tmp_path / f"{PORT}{suffix}").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        assert remove_dead_participants(tmp_path) == []
    assert len(list(tmp_path.iterdir())) == 3


def test_file_that_a_process_has_mapped_stays_though_its_lock_is_free(tmp_path: Path) -> None:
    make(tmp_path, PORT, f"{PORT}_el")
    with (tmp_path / PORT).open("r+b") as file, mmap.mmap(file.fileno(), 64):
        assert remove_dead_participants(tmp_path) == []
    assert len(remove_dead_participants(tmp_path)) == 2


def test_files_without_a_lock_are_removed_only_when_they_are_old(tmp_path: Path) -> None:
    make(tmp_path, PORT, f"sem.{PORT}_mutex")
    assert remove_dead_participants(tmp_path) == []
    old = make(tmp_path, PORT, f"sem.{PORT}_mutex", age_s=2 * YOUNG_S)
    assert sorted(remove_dead_participants(tmp_path)) == old


def test_other_files_and_links_to_them_stay(tmp_path: Path) -> None:
    make(tmp_path, "robbie-1234", "sem.robot_mutex", "fastdds_notes", age_s=2 * YOUNG_S)
    (tmp_path / f"{PORT}_el").symlink_to(tmp_path / "robbie-1234")
    assert remove_dead_participants(tmp_path) == []
    assert len(list(tmp_path.iterdir())) == 4
