"""A log file with a maximum size."""

import contextlib
import errno
import os
from pathlib import Path

from robbie_mp.base.linux.private_files import private_opener, real_folder


class RotatingFile:
    """Appends to a file. A full `a.log` becomes `a.1.log`, that one `a.2.log`; the oldest is removed.

    logging.handlers.RotatingFileHandler prints a traceback for each line that a full disk refuses. Here the
    caller gets the error and continues.
    """

    def __init__(self, path: Path, max_bytes: int, files: int, head: bytes = b""):
        """Prepare; the file is opened with the first write.

        Args:
            path: the newest file; its folder exists.
            max_bytes: maximum size of each file.
            files: number of files, including the newest.
            head: the beginning of each file.
        """
        self.path = path
        self._max_bytes = max_bytes
        self._files = files
        self._head = head
        self._fd: int | None = None
        self._size = 0

    def write(self, data: bytes) -> None:
        """Append.

        Raises:
            OSError: the disk refused, for example because it is full (ENOSPC).
        """
        fd = self._open() if self._fd is None else self._fd
        if self._size > len(self._head) and self._size + len(data) > self._max_bytes:
            fd = self._rotate()
        written = os.write(fd, data)
        self._size += written
        if written < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def begin_anew(self) -> None:
        """Begin a new file with the next write, even if one exists, such as an earlier run's."""
        with contextlib.suppress(OSError):
            self._shift()

    def close(self) -> None:
        """Close the file; a later write opens it again."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

    def _open(self) -> int:
        fd = private_opener(str(self.path), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        try:
            self._size = os.fstat(fd).st_size or self._begin(fd)
        except OSError:
            os.close(fd)
            raise
        self._fd = fd
        return fd

    def _begin(self, fd: int) -> int:
        """Write the whole head or nothing; return its size."""
        written = os.write(fd, self._head)
        if written < len(self._head):
            os.ftruncate(fd, 0)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return written

    def _rotate(self) -> int:
        self.close()
        self._shift()
        return self._open()

    def _shift(self) -> None:
        with real_folder(self.path.parent) as fd, contextlib.suppress(FileNotFoundError):
            for number in range(self._files - 2, -1, -1):
                self._rename(numbered(self.path, number).name, numbered(self.path, number + 1).name, fd)
            if self._files == 1:
                os.unlink(self.path.name, dir_fd=fd)

    @staticmethod
    def _rename(name: str, older: str, folder_fd: int) -> None:
        with contextlib.suppress(FileNotFoundError):
            os.replace(name, older, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)


def numbered(path: Path, number: int) -> Path:
    """Return the path of a file after `number` newer ones have been begun."""
    return path.with_name(f"{path.stem}.{number}{path.suffix}") if number else path
