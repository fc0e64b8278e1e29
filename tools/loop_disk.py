"""A small disk that you can freeze: ext4 in a file, mounted by a loop device. Needs root on Linux.

A process that writes to a frozen file system sleeps in the kernel, and not even SIGKILL ends it, exactly as
on a stalled disk. This module freezes only the file systems that it made. A watchdog, a separate process,
thaws the file system when it has been frozen for too long, and thaws and unmounts it when its owner has died.
"""

import argparse
import contextlib
import fcntl
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType

from typing_extensions import Self

FREEZE = 0xC0045877
"""FIFREEZE of <linux/fs.h>."""
THAW = 0xC0045878
MAX_FROZEN_S = 60.0
TOOLS = ("mkfs.ext4", "mount", "umount")


class NoLoopDisk(RuntimeError):
    """This machine does not allow a disk that can be frozen. The text says why."""


class LoopDisk:
    """A file system that is mounted inside the `with` block.

    Args:
        size_bytes: size of its file.
        max_frozen_s: after this time the watchdog thaws it.
        at: an empty folder where it is mounted; None: a folder of its own.

    Attributes:
        folder: where it is mounted.
    """

    def __init__(
        self, size_bytes: int = 64 << 20, max_frozen_s: float = MAX_FROZEN_S, at: Path | None = None
    ):
        self._size_bytes = size_bytes
        self._max_frozen_s = max_frozen_s
        self._at = at
        self._base = Path()
        self._fd = -1
        self._watchdog: subprocess.Popen[str] | None = None
        self.folder = Path()

    def __enter__(self) -> Self:
        """Make and mount it.

        Raises:
            NoLoopDisk: this machine does not allow it.
        """
        if os.geteuid() != 0:
            raise NoLoopDisk("only root can mount and freeze a file system")
        if missing := [tool for tool in TOOLS if shutil.which(tool) is None]:
            raise NoLoopDisk(f"there is no {', '.join(missing)}")
        self._base = Path(tempfile.mkdtemp(prefix="robbie-disk-", dir="/tmp"))
        self.folder = self._at or self._base / "mounted"
        self.folder.mkdir(exist_ok=True)
        try:
            self._mount(self._base / "image")
        except BaseException:
            self._unmount()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Thaw, unmount and remove it."""
        self._unmount()

    def freeze(self) -> None:
        """Freeze the disk: from now on, all processes that write to it wait."""
        self._tell("frozen")
        fcntl.ioctl(self._fd, FREEZE, 0)

    def thaw(self) -> None:
        """Thaw the disk. Nothing happens if it is not frozen."""
        thaw(self._fd)
        self._tell("thawed")

    def _mount(self, image: Path) -> None:
        with image.open("wb") as file:
            file.truncate(self._size_bytes)
        _run("mkfs.ext4", "-q", str(image))
        _run("mount", "-o", "loop", str(image), str(self.folder))
        self._fd = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        if os.fstat(self._fd).st_dev == os.stat(self._base).st_dev:
            raise NoLoopDisk(f"{self.folder} is not a separate file system after mounting")
        self._watchdog = subprocess.Popen(
            [sys.executable, "-m", "tools.loop_disk", str(self.folder), str(self._max_frozen_s)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
            cwd=Path(__file__).parents[1],
        )
        assert self._watchdog.stdout is not None
        if self._watchdog.stdout.readline() != "watching\n":
            raise NoLoopDisk("the watchdog did not start")

    def _unmount(self) -> None:
        if self._fd >= 0:
            thaw(self._fd)
            os.close(self._fd)
            self._fd = -1
        if self._watchdog is not None:
            self._watchdog.communicate()  # at the end of its input, the watchdog unmounts the file system
            self._watchdog = None
        unmount(self.folder)
        if not os.path.ismount(self.folder):
            shutil.rmtree(self._base, ignore_errors=True)

    def _tell(self, what: str) -> None:
        assert self._watchdog is not None
        assert self._watchdog.stdin is not None
        self._watchdog.stdin.write(f"{what}\n")
        self._watchdog.stdin.flush()


def thaw(fd: int) -> None:
    """Thaw a file system; nothing happens if it is not frozen."""
    with contextlib.suppress(OSError):
        fcntl.ioctl(fd, THAW, 0)


def unmount(folder: Path) -> None:
    """Unmount a file system. If files in it stay open, detach it. Nothing happens if there is none."""
    for attempt in range(20):
        if not os.path.ismount(folder):
            return
        lazy = ["-l"] if attempt == 19 else []
        subprocess.run(["umount", *lazy, str(folder)], stderr=subprocess.DEVNULL, check=False)
        time.sleep(0.0 if not os.path.ismount(folder) else 0.1)


def watch(folder: Path, max_frozen_s: float) -> None:
    """Run as the watchdog: thaw the disk when it is frozen for too long; at the end of input, unmount it."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    print("watching", flush=True)
    until_s: float | None = None
    while True:
        wait_s = None if until_s is None else max(0.0, until_s - time.monotonic())
        if not select.select([0], [], [], wait_s)[0]:
            thaw(fd)
            until_s = None
            continue
        said = os.read(0, 4096)
        if not said:
            break
        until_s = time.monotonic() + max_frozen_s if said.endswith(b"frozen\n") else None
    thaw(fd)
    os.close(fd)
    unmount(folder)


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise NoLoopDisk(f"{' '.join(command)} failed: {done.stderr.strip()}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m tools.loop_disk", description="Runs the watchdog of a disk."
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("max_frozen_s", type=float)
    options = parser.parse_args()
    watch(options.folder, options.max_frozen_s)
