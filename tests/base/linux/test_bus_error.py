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
print(len(truncated), {*truncated.values()} == {path})
"""
CUT_FOR_MANY = """
import mmap, os, sys, threading
from robbie_mp.base.linux.bus_error import surviving_truncation
path, pages = sys.argv[1], 1000
with open(path, "r+b") as file:
    file.truncate(pages * mmap.PAGESIZE)
    memory = memoryview(mmap.mmap(file.fileno(), 0))[:: mmap.PAGESIZE]
with surviving_truncation(path):
    os.truncate(path, 0)
    threads = [threading.Thread(target=memory.tolist) for _ in range(8)]
    for thread in threads:
        thread.start()
    for byte in memory.tolist():
        assert byte == 0
    for thread in threads:
        thread.join()
print("survived")
"""
CUT_MUCH = """
import mmap, os, sys
from robbie_mp.base.linux.bus_error import surviving_truncation
path = sys.argv[1]
with open(path, "r+b") as file:
    file.truncate(64 << 20)
    memory = memoryview(mmap.mmap(file.fileno(), 0))[:: mmap.PAGESIZE]
with surviving_truncation(path) as truncated:
    os.truncate(path, 0)
    print(sum(memory), len(truncated))
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


def test_much_that_was_cut_off_is_replaced_at_once(tmp_path: Path) -> None:
    """It took longer than a module may hang, as memory was replaced page by page."""
    path = tmp_path / "memory"
    path.touch()
    ended = subprocess.run(
        [sys.executable, "-c", CUT_MUCH, str(path)], check=False, capture_output=True, text=True, timeout=60
    )
    assert ended.stdout == "0 1\n", ended.stderr


def test_several_threads_may_touch_what_was_cut_off_at_once(tmp_path: Path) -> None:
    """A thread that found the page replaced by another one ended the process."""
    path = tmp_path / "memory"
    path.touch()
    ended = subprocess.run(
        [sys.executable, "-c", CUT_FOR_MANY, str(path)],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ended.stdout == "survived\n", ended.stderr


def test_other_files_are_left_to_the_system(tmp_path: Path) -> None:
    path = tmp_path / "memory"
    path.touch()
    assert run(path, "/elsewhere/").returncode == -7


def test_process_may_end_by_what_was_cut_off_where_it_may_write(
    tmp_path: Path,
) -> None:
    path = tmp_path / "memory"
    path.touch()
    assert run(path, str(tmp_path), writable=False).returncode == -7
