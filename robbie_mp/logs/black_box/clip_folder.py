"""Clips on the disk: folders `clips/TIME-WHAT` in the results of runs, each a log of its own."""

import contextlib
import errno
import os
import re
import shutil
import stat
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from robbie_mp.base.linux.private_files import make_private_folder, private_opener, write_private
from robbie_mp.base.utc import file_stamp
from robbie_mp.logs.black_box.state import CLIP_NAME
from robbie_mp.logs.recording.appended_file import AppendedFile
from robbie_mp.logs.recording.bag_metadata import write_bag_metadata
from robbie_mp.logs.recording.errors import LogError
from robbie_mp.logs.recording.format import part_path
from robbie_mp.logs.recording.mcap_records import MAGIC
from robbie_mp.logs.recording.repair import repair, unwatched
from robbie_mp.run.results import NAME as RESULTS

CLIPS = "clips"
ABOUT = "clip.json"
PINNED = "pinned"
COPIED_BYTES = 1 << 20
MAX_ABOUT_BYTES = 1 << 20
_NO_LETTER = re.compile(r"[^a-z0-9]+")


@dataclass(frozen=True)
class AboutClip:
    """The file `clip.json` in the folder of a clip."""

    run_id: str
    profile: str
    triggers: list[str]
    """What happened, in this order."""
    times_s: list[float]
    """When, seconds since 1970."""
    more: int
    """Triggers that are not named."""
    missing: str
    """Why it is not whole; '' if it is."""


@dataclass(frozen=True)
class SavedClip:
    """A clip on the disk."""

    folder: Path
    about: AboutClip | None
    """None: it is being written, or its writer was killed."""
    bytes: int
    is_pinned: bool


def clip_name(trigger: str, taken: Iterable[str], time_s: float | None = None) -> str:
    """Return a name for the folder of a clip at a time, or now, which is not taken yet."""
    base = f"{file_stamp(time_s)}-{_NO_LETTER.sub('-', trigger.lower()).strip('-')[:40].strip('-') or 'mark'}"
    names = (base if not number else f"{base}-{number + 1}" for number in range(10_000))
    return next(name for name in names if name not in set(taken))


def clip_folders(output_directory: Path) -> Iterator[Path]:
    """Yield the folders of clips of a run, and of the earlier runs beside it."""
    beside = RESULTS.fullmatch(output_directory.name) is not None
    for folder in output_directory.parent.glob(f"*/{CLIPS}") if beside else [output_directory / CLIPS]:
        if not folder.is_symlink():
            yield folder


def saved_clips(folders: Iterable[Path]) -> list[SavedClip]:
    """Return the clips in some folders, the oldest first, without those that cannot be read."""
    found: list[SavedClip] = []
    for folder in folders:
        with contextlib.suppress(OSError):  # another user's, or another run has just removed it
            found += [
                _read(path)
                for path in folder.iterdir()
                if CLIP_NAME.fullmatch(path.name) and path.is_dir() and not path.is_symlink()
            ]
    return sorted(found, key=lambda clip: clip.folder.name)


def _read(folder: Path) -> SavedClip:
    about, size = None, 0
    with (
        contextlib.suppress(OSError, ValueError),
        open(folder / ABOUT, "rb", opener=private_opener) as file,
    ):
        about = msgspec.json.decode(file.read(MAX_ABOUT_BYTES), type=AboutClip)
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            with contextlib.suppress(OSError):
                size += path.lstat().st_size
    return SavedClip(folder, about, size, os.path.lexists(folder / PINNED))


class ClipFolder:
    """Writes the clips of one run.

    Args:
        output_directory: the results of the run.
        budget_bytes: size of all clips of this run and of those beside it.
    """

    def __init__(self, output_directory: Path, budget_bytes: int):
        self.path = output_directory / CLIPS
        self._output_directory = output_directory
        self._budget_bytes = budget_bytes
        self.removed = 0
        """Old clips that made room for others."""

    def names(self) -> list[str]:
        """Return the names that are taken."""
        return os.listdir(self.path) if self.path.is_dir() else []

    def add_part(self, clip: str, part: Path, number: int) -> None:
        """Copy a part of the ring that is not written any more; nothing happens if that has been done.

        Raises:
            LookupError: the ring does not have the part any more.
            OSError: it cannot be written, or there is no room for it.
        """
        folder = self.path / clip
        target = part_path(folder, number)
        if target.exists():
            return
        try:
            source = os.fdopen(private_opener(str(part), os.O_RDONLY | os.O_NONBLOCK), "rb")
        except FileNotFoundError as error:
            raise LookupError(str(error)) from error
        with source:
            found = os.fstat(source.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise LookupError(f"{part} is no file")
            make_private_folder(self.path)
            make_private_folder(folder)
            self._make_room(found.st_size, folder)
            while True:
                try:
                    self._copy(part, source.fileno(), target)
                    return
                except OSError as error:
                    if error.errno != errno.ENOSPC or not self._remove_oldest(folder):
                        raise

    def _copy(self, part: Path, source: int, target: Path) -> None:
        unfinished = target.with_name(f".{target.name}.new")
        unfinished.unlink(missing_ok=True)
        size = os.fstat(source).st_size
        if os.pread(source, len(MAGIC), max(0, size - len(MAGIC))) != MAGIC:
            with contextlib.suppress(LogError, OSError):  # then it is copied as it is
                repair(part, unfinished, unwatched)
                unfinished.rename(target)
                return
        file = AppendedFile(unfinished)
        try:
            at = 0
            while at < size and (data := os.pread(source, COPIED_BYTES, at)):
                file.append([data])
                at += len(data)
            os.fsync(file.fd)
            unfinished.rename(target)
        except BaseException:
            unfinished.unlink(missing_ok=True)
            raise
        finally:
            file.close()

    def finish(self, clip: str, about: AboutClip) -> int:
        """Describe a clip whose parts are all there; return its size in bytes.

        Raises:
            OSError: it cannot be described.
        """
        folder = self.path / clip
        make_private_folder(folder)
        with contextlib.suppress(LogError, OSError):  # without it, all but ROS 2 open the clip
            write_bag_metadata(folder)
        # The last file: a clip that has it is whole.
        write_private(folder / ABOUT, msgspec.json.format(msgspec.json.encode(about)), durably=True)
        return _read(folder).bytes

    def _make_room(self, size: int, own: Path) -> None:
        clips = saved_clips(clip_folders(self._output_directory))
        total = sum(clip.bytes for clip in clips) + size
        for clip in clips:
            if total <= self._budget_bytes:
                return
            if clip.folder != own and not clip.is_pinned and self._remove(clip.folder):
                total -= clip.bytes
        if total > self._budget_bytes:
            raise OSError(errno.EDQUOT, f"pinned clips use the {self._budget_bytes} bytes for clips")

    def _remove_oldest(self, own: Path) -> bool:
        clips = saved_clips(clip_folders(self._output_directory))
        return any(self._remove(clip.folder) for clip in clips if clip.folder != own and not clip.is_pinned)

    def _remove(self, folder: Path) -> bool:
        try:
            shutil.rmtree(folder)  # which follows no links
        except OSError:
            return False
        self.removed += 1
        return True
