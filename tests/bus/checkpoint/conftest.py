import os
from collections.abc import Iterator

import pytest

from robbie_mp.bus.checkpoint.buffers import CheckpointBuffers
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY, make_folder, remove_names

RUN = f"test{os.getpid()}"  # no id that a run can have: a `robbie run` elsewhere would sweep it as dead
SLOT = 1


class SlotOfARun:
    """The shared memory for one module's checkpoints, whose processes come and go."""

    def __init__(self) -> None:
        self._open: list[CheckpointBuffers] = []
        make_folder(RUN)

    def start(self, limit_bytes: int = 1 << 20, *, is_expected: bool = False) -> CheckpointBuffers:
        """A new incarnation; those before have ended."""
        self.end()
        made = CheckpointBuffers(RUN, SLOT, len(self._open) + 1, limit_bytes, is_expected=is_expected)
        self._open.append(made)
        return self._open[-1]

    def end(self) -> None:
        for buffers in self._open:
            buffers.close()
        self._open.clear()

    def forget(self) -> None:
        """The run has ended."""
        self.end()
        remove_names(RUN)

    def name(self, number: int) -> str:
        return names.checkpoint(RUN, SLOT, number)

    def scribble(self, number: int, offset: int, data: bytes) -> None:
        """Overwrite a part of a segment."""
        with open(SHARED_MEMORY / self.name(number), "r+b") as file:
            file.seek(offset)
            file.write(data)

    def damage(self, number: int, offset: int, size: int = 1) -> None:
        """Flip all bits of a part of a segment: whatever is there, it becomes something else."""
        with open(SHARED_MEMORY / self.name(number), "r+b") as file:
            file.seek(offset)
            flipped = bytes(byte ^ 0xFF for byte in file.read(size))
        self.scribble(number, offset, flipped)


@pytest.fixture
def slot() -> Iterator[SlotOfARun]:
    made = SlotOfARun()
    yield made
    made.forget()


@pytest.fixture
def full_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on there is no room in /dev/shm."""

    def refuse(_fd: int, _offset: int, _size: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", refuse)
