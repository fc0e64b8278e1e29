"""Copies clips from the ring to the disk, in a thread: a disk may stall, and the black box must not."""

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

from robbie_mp.logs.black_box.clip_folder import AboutClip, ClipFolder
from robbie_mp.logs.black_box.state import OpenClip
from robbie_mp.logs.recording.format import part_path

RETRY_S = 1.0
GIVE_UP_S = 10.0
"""How long a clip whose parts are all known may fail before it is given up."""


@dataclass(frozen=True)
class ClipResult:
    """How a clip ended."""

    clip: OpenClip
    bytes: int
    missing: str
    """Why it is not on the disk, or not whole; '' if it is."""


@dataclass
class _Job:
    clip: OpenClip
    parts: set[int] = field(default_factory=set)
    """Parts that can be copied."""
    copied: set[int] = field(default_factory=set)
    lost: set[int] = field(default_factory=set)
    """Parts that the ring had no longer."""
    is_whole: bool = False
    """Whether `parts` are all parts of the clip."""
    error: str = ""
    failing_since_s: float = 0.0
    retry_at_s: float = 0.0


class ClipWriter:
    """Writes clips, several at a time.

    Args:
        ring: folder of the ring's parts.
        folder: where clips go.
        run_id, profile: for the description of the clips.
        log: receives errors.

    Attributes:
        results: the clips that are finished; take them away.
    """

    def __init__(self, ring: Path, folder: ClipFolder, run_id: str, profile: str, log: logging.Logger):
        self._ring = ring
        self._folder = folder
        self._run_id = run_id
        self._profile = profile
        self._log = log
        self._jobs: dict[str, _Job] = {}
        self._ended: set[str] = set()
        self._condition = threading.Condition()
        self._ends_s: float | None = None
        self.results: deque[ClipResult] = deque()
        self._thread = threading.Thread(target=self._run, name="clip writer", daemon=True)
        self._thread.start()

    def copy(self, clip: OpenClip, parts: set[int], *, is_whole: bool) -> None:
        """Copy parts of a clip; parts that were named before are not copied again.

        Args:
            clip: the clip.
            parts: numbers of parts that are not written any more.
            is_whole: whether no others will follow.
        """
        with self._condition:
            if clip.name in self._ended:
                return
            job = self._jobs.setdefault(clip.name, _Job(clip))
            if is_whole and not job.is_whole:
                job.failing_since_s = time.monotonic()
            job.parts = job.parts | parts
            job.is_whole = job.is_whole or is_whole
            self._condition.notify()

    @property
    def error(self) -> str:
        """Why a clip cannot be written at the moment; '' if all can."""
        return next((job.error for job in [*self._jobs.values()] if job.error), "")

    def close(self, wait_s: float) -> bool:
        """End when all clips are written; return whether that was done in time."""
        with self._condition:
            self._ends_s = time.monotonic() + wait_s
            self._condition.notify()
        self._thread.join(wait_s + RETRY_S)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._condition:
                if self._ends_s is not None and (not self._jobs or time.monotonic() > self._ends_s):
                    return
                if not any(self._is_due(job) for job in self._jobs.values()):
                    self._condition.wait(RETRY_S / 4 if self._jobs else None)
                due = [job for job in self._jobs.values() if self._is_due(job)]
            for job in due:
                self._work(job)

    def _is_due(self, job: _Job) -> bool:
        if time.monotonic() < job.retry_at_s:
            return False
        return job.is_whole or bool(job.parts - job.copied - job.lost)

    def _work(self, job: _Job) -> None:
        try:
            for number in sorted(job.parts - job.copied - job.lost):
                self._copy_one(job, number)
            if job.is_whole and job.parts <= job.copied | job.lost:
                self._finish(job)
                return
            job.error = ""
        except OSError as error:
            self._fail(job, error.strerror or str(error))
        except Exception as error:  # an error of ours must cost no other clip, nor be silent
            self._log.exception("clip %s cannot be written", job.clip.name)
            self._fail(job, f"{type(error).__name__}: {error}")

    def _copy_one(self, job: _Job, number: int) -> None:
        try:
            self._folder.add_part(job.clip.name, part_path(self._ring, number), number)
            job.copied.add(number)
        except LookupError:
            job.lost.add(number)

    def _finish(self, job: _Job) -> None:
        clip = job.clip
        missing = f"the ring had {len(job.lost)} of its parts no longer" if job.lost else ""
        missing = missing if job.copied else "the ring had none of its parts any more"
        about = AboutClip(
            self._run_id, self._profile, list(clip.triggers), list(clip.times_s), clip.more, missing
        )
        size = self._folder.finish(clip.name, about)
        self._end(job, size, missing)

    def _fail(self, job: _Job, error: str) -> None:
        if not job.error:
            self._log.error("clip %s cannot be written: %s", job.clip.name, error)
        job.error = error
        now_s = time.monotonic()
        job.retry_at_s = now_s + RETRY_S
        if job.is_whole and now_s - job.failing_since_s > GIVE_UP_S:
            self._end(job, 0, error)

    def _end(self, job: _Job, size: int, missing: str) -> None:
        with self._condition:
            del self._jobs[job.clip.name]
            self._ended.add(job.clip.name)
        self.results.append(ClipResult(job.clip, size, missing))
