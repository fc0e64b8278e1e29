"""Tells at once when files of some folders are saved (inotify(7)).

Not every file system tells: network and shared folders of virtual machines often do not. So look yourself now
and then as well.
"""

import contextlib
import ctypes
import os

_CLOSE_WRITE, _MOVED_TO = 0x8, 0x80
READ_BYTES = 1 << 16
MAX_FOLDERS = 1000


class FileEvents:
    """Becomes readable when a file was saved.

    Attributes:
        fd: the descriptor to wait for; -1: the kernel gives none.
    """

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self.fd = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        self._folders: set[str] = set()

    def watch(self, folder: str) -> None:
        """Tell of files in this folder, too, but not beyond `MAX_FOLDERS` and the kernel's limit."""
        if self.fd >= 0 and folder not in self._folders and len(self._folders) < MAX_FOLDERS:
            self._folders.add(folder)
            self._libc.inotify_add_watch(self.fd, os.fsencode(folder), _CLOSE_WRITE | _MOVED_TO)

    def forget(self) -> None:
        """Read what has been told."""
        with contextlib.suppress(BlockingIOError):
            while os.read(self.fd, READ_BYTES):
                pass

    def close(self) -> None:
        """Close the descriptor."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1
