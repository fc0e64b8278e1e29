"""How far a recorder has got in the order of the run, in memory that may outlive its process."""

import mmap
import os
from pathlib import Path

from typing_extensions import Self

_FLAGS = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC


class Position:
    """The sequence number of the last message that a recorder has received.

    Messages arrive in the order of the run. So a message with this or a smaller number is from before the
    recording: the core has kept it, because its channel is latched.

    Args:
        begin: the sequence number before the first message of the recording.
        words: one word that holds the position; if an earlier process has written it, `begin` does not count.
    """

    def __init__(self, begin: int, words: "memoryview[int] | None" = None):
        self._words: memoryview[int] = memoryview(bytearray(8)).cast("Q") if words is None else words
        if not self._words[0]:
            self.sequence = begin

    @classmethod
    def kept(cls, begin: int, folder: Path, recorder: str) -> Self:
        """Keep the position in a file, for the next process of the recorder.

        Args:
            begin: as above.
            folder: the folder of the run's shared memory, which is removed with the run.
            recorder: name of the file in it.

        Raises:
            OSError: there is no room for the file.
        """
        file = os.open(folder / f"{recorder}.position", _FLAGS, 0o600)
        try:
            os.posix_fallocate(file, 0, mmap.PAGESIZE)
            return cls(begin, memoryview(mmap.mmap(file, mmap.PAGESIZE)).cast("Q"))
        finally:
            os.close(file)

    @property
    def sequence(self) -> int:
        """The sequence number of the last message received."""
        return self._words[0] - 1

    @sequence.setter
    def sequence(self, sequence: int) -> None:
        self._words[0] = sequence + 1  # 0: no process has written it

    def close(self) -> None:
        """Unmap the position."""
        self._words.release()
