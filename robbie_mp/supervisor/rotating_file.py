"""A log file that never grows beyond its bound."""

import os
from pathlib import Path

from robbie_mp.errors import RobbieError


class RotatingFile:
    """Appends to a file; when that is full it becomes `.1`, the former `.1` becomes `.2`, the oldest goes.

    logging.handlers.RotatingFileHandler prints a traceback for each line that a full disk refuses; here the
    caller learns of it and goes on.
    """

    def __init__(self, path: Path, max_bytes: int, files: int):
        """Open the file, making its folder if need be.

        Args:
            path: the newest file.
            max_bytes: bound of each file.
            files: how many, the newest included.

        Raises:
            LogNotWritable: the file cannot be made.
        """
        self.path = path
        self._max_bytes = max_bytes
        self._files = files
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._open()
        except OSError as error:
            raise LogNotWritable(
                f"cannot write the log {path}: {error.strerror}; choose another directory"
            ) from error

    def write(self, data: bytes) -> bool:
        """Append; False if the disk refused, as when it is full."""
        try:
            if self._size and self._size + len(data) > self._max_bytes:
                self._rotate()
            written = os.write(self._fd, data)
        except OSError:
            return False
        self._size += written
        return written == len(data)

    def close(self) -> None:
        """Close the file."""
        os.close(self._fd)

    def _open(self) -> None:
        self._fd = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        self._size = os.fstat(self._fd).st_size

    def _rotate(self) -> None:
        for number in range(self._files - 2, -1, -1):
            older = self._numbered(number)
            if older.exists():
                older.replace(self._numbered(number + 1))
        if self._files == 1:
            self.path.unlink()
        full = self._fd
        self._open()
        os.close(full)

    def _numbered(self, number: int) -> Path:
        return self.path.with_name(f"{self.path.name}.{number}") if number else self.path


class LogNotWritable(RobbieError, OSError):
    """A log file cannot be made: no such place, no permission, or the disk is full."""
