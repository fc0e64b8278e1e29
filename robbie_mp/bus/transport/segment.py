"""A segment: named shared memory that one process creates and others attach to.

A segment is a file in the run's folder in /dev/shm. shm_open(3) does not suit, as its names cannot lie in a
folder; nor does multiprocessing.shared_memory, whose resource tracker unlinks segments still in use.
"""

import contextlib
import errno
import mmap
import os

from typing_extensions import Self

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.forks import keep_from_forks
from robbie_mp.base.linux.private_files import ownership_problem
from robbie_mp.base.linux.proc import ProcessIdentity
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.shared_folder import (
    ForeignMemory,
    SegmentMismatch,
    SegmentMissing,
    opened_folder,
    remove_file,
)
from robbie_mp.bus.transport.words import WORD_BYTES, Words, check_machine, new_fence

_MADV_POPULATE_WRITE = 23  # Linux 5.14

__all__ = [
    "ForeignMemory",
    "Segment",
    "SegmentMismatch",
    "SegmentMissing",
    "SharedMemoryFull",
    "unlink_segment",
]


class SharedMemoryFull(RobbieError, MemoryError):
    """The system has no room for another segment.

    Example scenarios:
      - /dev/shm is smaller than the profile's limits (a container's default is 64 MB)
      - another program fills it
      - the process has as many descriptors open as it may (`ulimit -n`)
    """

    @classmethod
    def of(cls, piece: str, error: OSError) -> Self:
        """Return the error for one segment or wake-up, with the reason that the system gave."""
        return cls(
            f"no room in /dev/shm for {piece} ({error.strerror or error}); "
            "lower the profile's memory limits, enlarge /dev/shm, or allow more descriptors (ulimit -n)"
        )


class Segment:
    """One mapped segment.

    Attributes:
        name: its name in /dev/shm, as FOLDER/FILE.
        buffer: all of its bytes; read-only unless this process created it or attached as the writer.
        populated_bytes: so much of it has its memory.
        words: the same memory as unsigned 64-bit words.
    """

    def __init__(self, name: str, mapping: mmap.mmap):
        self.name = name
        self._mapping = mapping
        self.buffer = memoryview(mapping)
        self._cast = self.buffer.cast("Q")
        self.populated_bytes = len(mapping)
        if not self.buffer.readonly:
            keep_from_forks(self)

    def disown(self) -> None:
        """Prevent a forked process from writing words; arrays of messages and loans stay as they are.

        This is the last barrier: most objects raise ForkedProcess before they get here.
        """
        self._cast.release()

    @property
    def words(self) -> Words:
        """The memory as words."""
        return self._cast

    @property
    def size(self) -> int:
        """Size in bytes."""
        return len(self.buffer)

    @classmethod
    def create(
        cls,
        name: str,
        words: int,
        kind: layout.SegmentKind,
        slot: int = 0,
        incarnation: int = 0,
        at_first_bytes: int | None = None,
    ) -> Self:
        """Create a segment and allocate all its pages, so that a full /dev/shm is an error here.

        With `at_first_bytes`, only that many bytes are allocated here, and `populate` allocates the rest
        later. A system that cannot do that allocates all of them here. `populated_bytes` tells which.

        Raises:
            SharedMemoryFull: there is no room for it.
            FileExistsError: the name is taken.
            SegmentMissing: its run has no folder.
            ForeignMemory: other users have access to that folder.
            UnsuitableMachine: this Python cannot use segments.
        """
        check_machine()
        size = words * WORD_BYTES
        folder, _, file = name.partition("/")
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            creator = ProcessIdentity.own()
            with opened_folder(folder) as folder_fd:
                fd = os.open(file, flags, 0o600, dir_fd=folder_fd)
                try:
                    mapping, populated_bytes = _allocated(fd, size, at_first_bytes)
                except OSError:
                    os.unlink(file, dir_fd=folder_fd)
                    raise
                finally:
                    os.close(fd)
        except (FileExistsError, SegmentMissing):
            raise
        except OSError as error:  # no memory, no inode, or no descriptor
            raise SharedMemoryFull.of(f"segment {name} of {size} bytes", error) from error
        segment = cls(name, mapping)
        segment.populated_bytes = populated_bytes
        header = segment.words
        header[layout.HEADER_VERSION] = layout.LAYOUT_VERSION
        header[layout.HEADER_KIND] = kind
        header[layout.HEADER_BYTES] = size
        header[layout.HEADER_SLOT] = slot
        header[layout.HEADER_INCARNATION] = incarnation
        header[layout.HEADER_CREATOR_PID] = creator.pid
        header[layout.HEADER_CREATOR_START] = creator.start_ticks
        new_fence()()  # the magic tells others that the rest of the header is there
        header[layout.HEADER_MAGIC] = layout.MAGIC
        return segment

    @classmethod
    def attach(cls, name: str, kind: layout.SegmentKind, *, write: bool = False) -> Self:
        """Map an existing segment, read-only unless `write`.

        Raises:
            SegmentMissing: no segment has that name, or it is still being made.
            SegmentMismatch: it is of another kind or layout version.
            ForeignMemory: other users have access to it.
            UnsuitableMachine: this Python cannot use segments.
        """
        segment = cls.map(name, write=write)
        magic = segment.words[layout.HEADER_MAGIC]
        new_fence()()
        header = [magic, *(segment.words[index] for index in range(1, 4))]
        wanted = [layout.MAGIC, layout.LAYOUT_VERSION, kind, segment.size]
        if header != wanted:
            segment.close()
            if magic == 0:  # it is written last
                raise SegmentMissing(f"shared memory {name} is just being made")
            raise SegmentMismatch(
                f"shared memory {name} has magic, layout version, kind and size {header}, expected {wanted}; "
                "every process of a run must use the same version of Robbie-MP"
            )
        return segment

    @classmethod
    def map(cls, name: str, *, write: bool) -> Self:
        """Map an existing segment without a look at its header, which other modules may have written.

        Raises:
            SegmentMissing: no segment has that name, or it is still being made.
            SegmentMismatch: it is smaller than any segment.
            ForeignMemory: other users have access to it.
            UnsuitableMachine: this Python cannot use segments.
        """
        check_machine()
        fd = _open(name, os.O_RDWR if write else os.O_RDONLY)
        try:
            found = os.fstat(fd)
            if problem := ownership_problem(found):
                raise ForeignMemory(f"shared memory {name} {problem}")
            size = found.st_size
            if size == 0:
                raise SegmentMissing(f"shared memory {name} is just being made")
            if size < layout.HEADER_WORDS * WORD_BYTES:
                raise SegmentMismatch(f"shared memory {name} of {size} bytes is no segment of Robbie-MP")
            access = mmap.PROT_READ | mmap.PROT_WRITE if write else mmap.PROT_READ
            mapping = mmap.mmap(fd, size, prot=access)
        finally:
            os.close(fd)
        return cls(name, mapping)

    def populate(self, begin: int, end: int) -> bool:
        """Allocate and touch the pages of some bytes; False if there is no room, or the system cannot."""
        return _populate(self._mapping, begin, end)

    def part(self, start: int, count: int) -> memoryview:
        """Return some words as an object of their own; release it before the segment is closed."""
        return self._cast[start : start + count]

    def copy(self, start: int, count: int) -> list[int]:
        """Copy some words out."""
        return self._cast[start : start + count].tolist()

    def close(self) -> None:
        """Unmap the segment; arrays over it keep the memory mapped until they are freed."""
        try:
            self._cast.release()
            self.buffer.release()
            self._mapping.close()
        except BufferError:
            pass  # arrays or C code still use it: the last one to be freed unmaps it

    def unlink(self) -> None:
        """Remove the name; the memory stays until the last process has unmapped it."""
        unlink_segment(self.name)


def _allocated(fd: int, size: int, at_first_bytes: int | None) -> tuple[mmap.mmap, int]:
    """Map a new file; return how much of it has its memory, too."""
    if at_first_bytes is not None:
        os.ftruncate(fd, size)
        mapping = mmap.mmap(fd, size)
        # qemu's emulation of a single program accepts all advice and ignores this one.
        if _populate(mapping, 0, at_first_bytes) and os.fstat(fd).st_blocks * 512 >= at_first_bytes:
            return mapping, at_first_bytes
        mapping.close()  # it holds a descriptor
    os.posix_fallocate(fd, 0, size)
    return mmap.mmap(fd, size), size


def _populate(mapping: mmap.mmap, begin: int, end: int) -> bool:
    try:
        mapping.madvise(_MADV_POPULATE_WRITE, begin, end - begin)
    except (OSError, ValueError):  # ValueError: it is closed
        return False
    return True


def unlink_segment(name: str) -> None:
    """Remove a segment's name if it is there."""
    folder, _, file = name.partition("/")
    with contextlib.suppress(OSError, ForeignMemory), opened_folder(folder) as folder_fd:
        remove_file(file, folder_fd)


def _open(name: str, access: int) -> int:
    folder, _, file = name.partition("/")
    with opened_folder(folder) as folder_fd:
        try:
            return os.open(file, access | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder_fd)
        except FileNotFoundError as error:
            raise SegmentMissing(f"there is no shared memory {name}; its run is over") from error
        except OSError as error:
            if error.errno in (errno.ELOOP, errno.EACCES, errno.EISDIR, errno.ENXIO):
                raise ForeignMemory(f"shared memory {name} is not ours: {error.strerror}") from error
            raise
