"""The checkpoints of one incarnation of a module: what it restores, and what it saves for the next."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from robbie_mp.bus.checkpoint.buffers import CheckpointBuffers
from robbie_mp.bus.checkpoint.errors import CheckpointDamaged, CheckpointForeign, CheckpointTooNew
from robbie_mp.bus.checkpoint.file import CheckpointFileError, CheckpointWriter, read_file, set_aside
from robbie_mp.bus.checkpoint.image import Checkpoint, ImageLayout, lay_out
from robbie_mp.bus.transport.segment import SharedMemoryFull


class Checkpoints(Protocol):
    """The interface of checkpoints that a module uses."""

    @property
    def restored(self) -> Any:
        """The state to continue from; None for a fresh start."""

    @property
    def lost(self) -> int:
        """How many checkpoints that are newer than `restored` were damaged, or could not be read."""

    def save(self, state: object) -> bool:
        """Store a state outside the process; return False if there is no memory for it."""


@dataclass(frozen=True)
class DiskPolicy:
    """The file for checkpoints that outlive the run, and the shortest period between writes."""

    path: Path
    every_s: float


class CheckpointKeeper:
    """Keeps checkpoints in shared memory and, if there is a policy for it, on disk.

    The checkpoint of an earlier incarnation in this run is preferred; one on disk, from an earlier run, is
    used for the first start only. A checkpoint that cannot be read does not prevent the start: the module
    logs an error and continues from an older one or starts fresh, and a file is renamed and kept.

    Args:
        buffers: the shared memory.
        disk: None: nothing is kept on disk.
        log: receives messages about checkpoints found, refused or damaged.
        on_saved: called with what was stored when a checkpoint is complete.
        is_fresh: whether the module starts fresh, although there may be a checkpoint.

    Attributes:
        restored: the state to continue from; None for a fresh start.
        lost: how many checkpoints that are newer were damaged, could not be read, or were left out.
        refused: number of checkpoints for which there was no memory.
    """

    def __init__(
        self,
        buffers: CheckpointBuffers,
        disk: DiskPolicy | None,
        log: logging.Logger,
        on_saved: Callable[[ImageLayout], None] = lambda _image: None,
        *,
        is_fresh: bool = False,
    ):
        self._buffers, self._on_saved = buffers, on_saved
        self._log = log
        self.refused = 0
        self.lost = len(buffers.damaged)
        for damage in buffers.damaged:
            log.error("the newest checkpoint is lost: %s", damage)
        found = None if is_fresh else buffers.found
        if is_fresh:
            log.info("starts fresh, as ordered")
            self.lost += buffers.found is not None  # a base must not forget that its stop is engaged
        elif found is None and disk is not None:
            found = self._read(disk.path)
        if found is not None:
            log.info("restored from a checkpoint that is %.1f s old", (time.time_ns() - found.taken_ns) / 1e9)
        self.restored = None if found is None else found.state
        self._disk: CheckpointWriter | None = None
        if disk is not None:
            self._disk = CheckpointWriter(disk.path, disk.every_s, buffers.newest, log)
            if buffers.found is not None:
                self._disk.write_soon()  # the process that saved it may have been killed before it wrote it

    def save(self, state: object) -> bool:
        """Store a state; return False if there is no memory for it. The previous checkpoint then stays.

        Raises:
            UnsupportedState, CheckpointTooLarge: the state cannot be stored; the previous one stays.
        """
        try:
            image = lay_out(state)
            self._buffers.write(image, time.time_ns())
        except SharedMemoryFull as error:
            self.refused += 1
            if self.refused.bit_count() == 1:  # the 1st, 2nd, 4th, 8th …
                self._log.warning("%d checkpoints refused; the last one stays: %s", self.refused, error)
            return False
        self._on_saved(image)
        if self._disk is not None:
            self._disk.write_soon()
        return True

    def close(self) -> None:
        """Write the newest checkpoint to disk and unmap the memory, which stays for the next incarnation."""
        if self._disk is not None:
            self._disk.close()
        self._buffers.close()

    def _read(self, path: Path) -> Checkpoint | None:
        try:
            return read_file(path)
        except CheckpointFileError as error:
            self._log.error("starts fresh: %s", error)
        except CheckpointDamaged as error:
            self._log.error("starts fresh: %s; %s", error, _kept_aside(path, "damaged"))
        except CheckpointForeign as error:
            self._log.error("starts fresh: %s; %s", error, _kept_aside(path, "foreign"))
        except CheckpointTooNew as error:
            self._log.error("starts fresh: %s; %s", error, _kept_aside(path, "too-new"))
        self.lost += 1
        return None


def _kept_aside(path: Path, why: str) -> str:
    try:
        return f"the file is kept as {set_aside(path, why)}"
    except CheckpointFileError as error:
        return str(error)
