"""A checkpoint on disk: the file, and the thread that writes it.

The file is replaced atomically. Whenever power is lost, it holds the old checkpoint or the new one.
"""

import logging
import os
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.private_files import PRIVATE_FOLDER, ownership_problem, write_private
from robbie_mp.bus.checkpoint.errors import CheckpointForeign
from robbie_mp.bus.checkpoint.image import HEADER, Checkpoint, check_crc, decode, read_header

STATE_FOLDER = "state"
SUFFIX = ".checkpoint"


class CheckpointFileError(RobbieError, OSError):
    """The file of a checkpoint cannot be read or renamed."""


def checkpoint_file(workspace: Path, profile_name: str, module_name: str) -> Path:
    """Return the file for the checkpoints of a profile's module; it is the same in every run."""
    return workspace / STATE_FOLDER / profile_name / f"{module_name}{SUFFIX}"


def read_file(path: Path) -> Checkpoint | None:
    """Read the checkpoint in a file; None if there is no file.

    Raises:
        CheckpointDamaged: the file holds no valid checkpoint.
        CheckpointTooNew: this version does not know the file's format.
        CheckpointForeign: another user may have written the file.
        CheckpointFileError: the file cannot be read.
    """
    try:
        with open(path, "rb", opener=_without_waiting) as file:
            if problem := ownership_problem(os.fstat(file.fileno()), readable=True):
                raise CheckpointForeign(f"{path} {problem}")
            begin = file.read(HEADER.size)
            header = read_header(memoryview(begin), os.fstat(file.fileno()).st_size)
            return decode(begin + file.read(header.size - len(begin)))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise CheckpointFileError(f"{path} cannot be read: {error.strerror}") from error


def write_file(path: Path, image: memoryview | bytes) -> None:
    """Replace the file by an image, durably; the old file stays until the new one is complete.

    Raises:
        OSError: the disk is full or refuses to write; the old file stays.
    """
    _make_folder(path.parent)
    write_private(path, image, durably=True)
    _sync_folder(path.parent)


def set_aside(path: Path, why: str) -> Path | None:
    """Rename a file to keep it without using it; return the new path, None if there is no file.

    Args:
        path: the checkpoint's file.
        why: becomes part of the new name; an earlier file set aside for the same reason is replaced.

    Raises:
        CheckpointFileError: the file cannot be renamed.
    """
    aside = path.with_name(f"{path.name}.{why}")
    try:
        path.replace(aside)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise CheckpointFileError(f"{path} cannot be renamed to {aside.name}: {error.strerror}") from error
    return aside


def _without_waiting(path: str, flags: int) -> int:
    """Open a file for `open` without blocking, in case it is a pipe."""
    return os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)


def _make_folder(folder: Path) -> None:
    """Make a folder and its parents, durably."""
    if not folder.is_dir():
        _make_folder(folder.parent)
        folder.mkdir(mode=PRIVATE_FOLDER, exist_ok=True)
        _sync_folder(folder.parent)


def _sync_folder(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


class CheckpointWriter:
    """Writes the newest checkpoint to a file, at most once in a period, and once more at the end.

    Args:
        path: the file.
        every_s: the period.
        newest: holds the image of the newest checkpoint while it is written.
        log: receives a warning if the disk refuses.
    """

    def __init__(
        self,
        path: Path,
        every_s: float,
        newest: Callable[[], AbstractContextManager[memoryview]],
        log: logging.Logger,
    ):
        self._path = path
        self._every_s = every_s
        self._newest = newest
        self._log = log
        self._change = threading.Condition()
        self._is_wanted = False
        self._is_closing = False
        self._thread = threading.Thread(target=self._run, name=f"write {path.name}", daemon=True)
        self._thread.start()

    def write_soon(self) -> None:
        """Have the newest checkpoint written when the period allows; return at once."""
        with self._change:
            self._is_wanted = True
            self._change.notify()

    def close(self) -> None:
        """Write the newest checkpoint if it is not on disk yet, and end the thread."""
        with self._change:
            self._is_closing = True
            self._change.notify()
        self._thread.join()

    def _run(self) -> None:
        not_before_s = time.monotonic()
        while self._waits_for_work(not_before_s):
            not_before_s = time.monotonic() + self._every_s
            try:
                with self._newest() as image:
                    # An image damaged in memory must not replace a good file.
                    check_crc(image, read_header(image, len(image)))
                    write_file(self._path, image)
            except (OSError, RobbieError) as error:
                self._log.warning("the checkpoint could not be written to disk: %s", error)

    def _waits_for_work(self, not_before_s: float) -> bool:
        """Wait until a checkpoint may be written; return False when the thread should end."""
        with self._change:
            self._change.wait_for(lambda: self._is_wanted or self._is_closing)
            self._change.wait_for(lambda: self._is_closing, not_before_s - time.monotonic())
            is_wanted, self._is_wanted = self._is_wanted, False
            return is_wanted
