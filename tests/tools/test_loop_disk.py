"""A disk that can be frozen. It is thawed and unmounted even if this process is killed."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from robbie_mp.base.linux.proc import read_stat
from tests._support.present import present
from tools.loop_disk import LoopDisk

LIMIT_S = 10.0


def wait_for_state(pid: int, states: str) -> None:
    deadline_s = time.monotonic() + LIMIT_S
    while (stat := read_stat(pid)) is not None and stat.state not in states:
        assert time.monotonic() < deadline_s, stat
        time.sleep(0.002)


def writer(folder: Path) -> "subprocess.Popen[bytes]":
    code = f"print('opening', flush=True); open({str(folder / 'file')!r}, 'w')"
    process = subprocess.Popen([sys.executable, "-S", "-c", code], stdout=subprocess.PIPE)
    with present(process.stdout) as said:  # before, it may wait for another disk
        assert said.readline() == b"opening\n"
    return process


def test_writer_to_a_frozen_disk_cannot_be_killed_before_it_is_thawed(disk: LoopDisk) -> None:
    disk.freeze()
    process = writer(disk.folder)
    wait_for_state(process.pid, "D")
    process.kill()
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.2)
    disk.thaw()
    process.wait(LIMIT_S)


@pytest.mark.usefixtures("disk")  # which skips where there can be none
def test_watchdog_thaws_a_forgotten_disk() -> None:
    with LoopDisk(max_frozen_s=0.5) as disk:
        disk.freeze()
        (disk.folder / "file").touch()  # waits until then
        assert (disk.folder / "file").exists()
    assert not disk.folder.exists()


@pytest.mark.usefixtures("disk")
def test_disk_of_a_killed_process_is_thawed_and_unmounted() -> None:
    script = (
        "import os, signal\n"
        "from tools.loop_disk import LoopDisk\n"
        "disk = LoopDisk().__enter__()\n"
        "disk.freeze()\n"
        "print(disk.folder, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        check=False,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    folder = Path(done.stdout.strip())
    deadline_s = time.monotonic() + LIMIT_S
    while os.path.ismount(folder):
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    (folder.parent / "image").unlink()
    folder.rmdir()
    folder.parent.rmdir()
