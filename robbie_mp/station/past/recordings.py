"""Recordings that operators start and stop on the page, each by `robbie record` in a process of its own."""

from __future__ import annotations

import calendar
import contextlib
import re
import shutil
import signal
import subprocess
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robbie_mp.base.linux.private_files import make_private_folder
from robbie_mp.base.utc import file_stamp
from robbie_mp.station.past.apart import last_line, start_apart

if TYPE_CHECKING:
    import logging
    from pathlib import Path

RECORDINGS = "recordings"
"""The folder in the results of the run."""
NAME = re.compile(r"(\d{8}T\d{6}Z)(-\d+)?")
PRINTED = "recorder.txt"
LEAST_FREE_BYTES = 1e9
"""With less free disk, a recording ends: the robot's own logs come first."""
LOOK_S = 1.0
STOP_S = 10.0
"""Time that a recording has to write its end."""
CLOSE_S = 1.5
"""The same when the station ends, which must not take long. What was written until then can be read."""
DISK_FULL = "the robot's disk is almost full"


@dataclass(frozen=True)
class SavedRecording:
    """A recording on the disk."""

    name: str
    time_s: float
    """When it began, seconds since 1970."""
    bytes: int


class RunRecorder:
    """Makes at most one recording of the run at a time. Any thread may call it.

    Args:
        run_id: the run.
        run_folder: the folder of the run, which ends with it.
        output_directory: the results of the run, which keep the recordings.
        log: receives what becomes of them.

    Attributes:
        name: of the recording that is being made; '' if there is none.
        error: why the last one has ended or could not begin, if no operator has ended it; '' otherwise.
    """

    def __init__(self, run_id: str, run_folder: Path, output_directory: Path, log: logging.Logger):
        self.name = self.error = ""
        self._run_id = run_id
        self._printed = run_folder / PRINTED
        self._folder = output_directory / RECORDINGS
        self._log = log
        self._process: subprocess.Popen[bytes] | None = None
        self._began_s = self._stopped_s = self._next_s = 0.0
        self._lock = threading.Lock()

    @property
    def seconds(self) -> float:
        """How long the recording that is being made has lasted."""
        return time.monotonic() - self._began_s if self.name else 0.0

    @property
    def is_ending(self) -> bool:
        """Whether it writes its end."""
        return bool(self._stopped_s)

    def start(self) -> None:
        """Begin a recording, unless one is being made."""
        with self._lock:
            if self._process is not None:
                return
            self.error = ""
            try:
                make_private_folder(self._folder)
                if self._is_full():
                    raise OSError(DISK_FULL)
                name = self._free_name()
                words = ["record", "--run", self._run_id, "--output", str(self._folder / name)]
                self._process = start_apart(words, self._folder, self._printed)
            except OSError as error:
                self.error = str(error)
                self._log.warning("no recording: %s", error)
                return
            self.name, self._began_s, self._stopped_s = name, time.monotonic(), 0.0
            self._log.info("recording %s, by hand", name)

    def stop(self) -> None:
        """Let the recording end."""
        with self._lock:
            self._stop()

    def tick(self) -> None:
        """Look whether it has ended, or must end because the disk is full."""
        if self._process is None or time.monotonic() < self._next_s or not self._lock.acquire(blocking=False):
            return
        try:
            if self._stopped_s or self._process.poll() is not None:
                self._look()
                return
            self._next_s = time.monotonic() + LOOK_S
            if self._is_full():
                self.error = DISK_FULL
                self._log.warning("recording %s ends: %s", self.name, DISK_FULL)
                self._stop()
        finally:
            self._lock.release()

    def close(self) -> None:
        """End the recording, and wait for its end."""
        with self._lock:
            self._stop()
            if self._process is not None:
                try:
                    self._process.wait(CLOSE_S)
                except subprocess.TimeoutExpired:
                    self._process.kill()
                    self._process.wait()
                self._look()

    def _stop(self) -> None:
        if self._process is not None and not self._stopped_s:
            self._stopped_s = time.monotonic()
            self._process.send_signal(signal.SIGINT)

    def _look(self) -> None:
        """Note that the process has ended, or end it if it takes too long."""
        process = self._process
        assert process is not None
        code = process.poll()
        if code is None:
            if time.monotonic() - self._stopped_s > STOP_S:
                process.kill()
            return
        if not self._stopped_s or code:
            self.error = self.error or last_line(self._printed) or f"exit code {code}"
            self._log.warning("recording %s has ended: %s", self.name, self.error)
        else:
            self._log.info("recording %s is complete: %.0f s", self.name, self.seconds)
        self._process, self.name, self._stopped_s = None, "", 0.0

    def _is_full(self) -> bool:
        return shutil.disk_usage(self._folder).free < LEAST_FREE_BYTES

    def _free_name(self) -> str:
        """Return a name that no recording has: two may begin in one second."""
        stamp, number = file_stamp(), 1
        while (self._folder / (name := stamp if number == 1 else f"{stamp}-{number}")).exists():
            number += 1
        return name


def saved_recordings(output_directory: Path) -> list[SavedRecording]:
    """Return the recordings of a run, the oldest first. Somebody may remove them meanwhile."""
    saved: list[SavedRecording] = []
    with contextlib.suppress(FileNotFoundError):
        for path in sorted((output_directory / RECORDINGS).iterdir()):
            if (found := NAME.fullmatch(path.name)) and path.is_dir():
                with contextlib.suppress(FileNotFoundError):
                    saved.append(SavedRecording(path.name, _begin_s(found[1]), _size(path)))
    return saved


def _begin_s(stamp: str) -> float:
    return float(calendar.timegm(time.strptime(stamp, "%Y%m%dT%H%M%SZ")))


def _size(folder: Path) -> int:
    sizes = 0
    for path in folder.iterdir():
        with contextlib.suppress(FileNotFoundError):
            sizes += path.stat().st_size
    return sizes
