"""A disk that can be frozen, for tests."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tools.loop_disk import LoopDisk, NoLoopDisk


@contextmanager
def freezable_disk(at: Path | None = None) -> Iterator[LoopDisk]:
    """Mount a disk that can be frozen; skip the test where there can be none.

    Args:
        at: an empty folder where it is mounted; None: a folder of its own.
    """
    try:
        made = LoopDisk(at=at).__enter__()
    except NoLoopDisk as error:
        pytest.skip(f"NOT TESTED, no disk can be frozen here: {error}")
    try:
        yield made
    finally:
        made.__exit__(None, None, None)
