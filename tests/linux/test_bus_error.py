import os
import subprocess
import sys
from pathlib import Path

from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY

RUN = f"testbus{os.getpid()}"
PREFIX = f"{SHARED_MEMORY}/robbie-{RUN}/"
CUT = """
import mmap, os, sys
from robbie_mp.base.linux.bus_error import surviving_truncation
path, prefix, writable = sys.argv[1:]
with open(path, "r+b") as file:
    file.truncate(3 * mmap.PAGESIZE)
    memory = memoryview(mmap.mmap(file.fileno(), 0))
memory[:] = b"x" * len(memory)
with surviving_truncation(prefix, writable=writable == "True") as truncated:
    os.truncate(path, mmap.PAGESIZE)
    memory[-1] = 1
    print(bytes(memory[mmap.PAGESIZE - 1 : mmap.PAGESIZE + 2]), memory[-1], memory[-2])
print(len(truncated), {*truncated} == {path})
"""


def run(path: Path, prefix: str, *, writable: bool = True) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", CUT, str(path), prefix, str(writable)],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_zeros_take_the_place_of_what_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "memory"
    path.touch()
    ended = run(path, str(tmp_path))
    assert ended.stdout.splitlines() == [r"b'x\x00\x00' 1 0", "2 True"], ended.stderr


def test_other_files_are_left_to_the_system(tmp_path: Path) -> None:
    path = tmp_path / "memory"
    path.touch()
    assert run(path, "/elsewhere/").returncode == -7


def test_process_ends_by_what_was_cut_off_where_it_may_write_if_it_would_write_in_vain(
    tmp_path: Path,
) -> None:
    path = tmp_path / "memory"
    path.touch()
    assert run(path, str(tmp_path), writable=False).returncode == -7
