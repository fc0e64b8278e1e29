"""The checkpoint that one incarnation leaves for the next, in the same run and in the next one."""

import logging
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_mp.bus.checkpoint import file
from robbie_mp.bus.checkpoint.buffers import IMAGE_BEGIN
from robbie_mp.bus.checkpoint.errors import CheckpointTooLarge, UnsupportedState
from robbie_mp.bus.checkpoint.file import read_file, write_file
from robbie_mp.bus.checkpoint.image import encode
from robbie_mp.bus.checkpoint.keeper import CheckpointKeeper, DiskPolicy
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from tests.bus.checkpoint.conftest import SlotOfARun

NEVER_S = 1e6
Starter = Callable[..., CheckpointKeeper]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "module.checkpoint"


@pytest.fixture
def start(slot: SlotOfARun, path: Path) -> Iterator[Starter]:
    """Starts an incarnation; on disk it writes once at once, and then only at its end."""
    keepers: list[CheckpointKeeper] = []

    def starter(every_s: float | None = NEVER_S, limit_bytes: int = 1 << 20) -> CheckpointKeeper:
        disk = None if every_s is None else DiskPolicy(path, every_s)
        keepers.append(CheckpointKeeper(slot.start(limit_bytes), disk, logging.getLogger("module")))
        return keepers[-1]

    yield starter
    for keeper in keepers:
        keeper.close()


def test_checkpoint_that_is_left_out_by_order_counts_as_lost(slot: SlotOfARun) -> None:
    """So a base that is swapped starts with its emergency stop engaged, for it may have been engaged."""
    log = logging.getLogger("module")
    nothing = CheckpointKeeper(slot.start(1 << 20), None, log, is_fresh=True)
    nothing.save({"engaged": True})
    nothing.close()
    fresh = CheckpointKeeper(slot.start(1 << 20), None, log, is_fresh=True)
    fresh.close()
    assert (nothing.lost, fresh.lost, fresh.restored) == (0, 1, None)


def on_disk(path: Path) -> Any:
    found = read_file(path)
    return None if found is None else found.state


class SlowDisk:
    """A slow disk: a write ends only after `release`."""

    def __init__(self) -> None:
        self.began = threading.Event()
        self._may_end = threading.Event()
        self.written: list[Any] = []

    def write(self, path: Path, image: memoryview) -> None:
        self.began.set()
        assert self._may_end.wait(10)
        write_file(path, image)
        self.written.append(on_disk(path))

    def release(self) -> None:
        self._may_end.set()


@pytest.fixture
def slow_disk(monkeypatch: pytest.MonkeyPatch) -> SlowDisk:
    disk = SlowDisk()
    monkeypatch.setattr(file, "write_file", disk.write)
    return disk


def test_first_start_is_fresh(start: Starter) -> None:
    assert start(every_s=None).restored is None


def test_restarted_module_continues(start: Starter, caplog: pytest.LogCaptureFixture) -> None:
    assert start(every_s=None).save({"scans": 3})
    caplog.set_level(logging.INFO)
    assert start(every_s=None).restored == {"scans": 3}
    assert "restored from a checkpoint" in caplog.text


def test_module_is_told_that_the_newest_checkpoint_was_damaged(
    start: Starter, slot: SlotOfARun, caplog: pytest.LogCaptureFixture
) -> None:
    keeper = start(every_s=None)
    assert keeper.lost == 0
    keeper.save([1])
    keeper.save([2])
    slot.damage(0, IMAGE_BEGIN + 70)
    again = start(every_s=None)
    assert (again.restored, again.lost) == ([1], 1)
    assert "the newest checkpoint is lost" in caplog.text


@pytest.mark.parametrize("how", ["removed", "zeroed"])
def test_run_that_has_saved_checkpoints_and_finds_none_has_lost_them(
    start: Starter, slot: SlotOfARun, caplog: pytest.LogCaptureFixture, how: str
) -> None:
    saved: list[int] = []
    keeper = CheckpointKeeper(slot.start(), None, logging.getLogger("module"), lambda _image: saved.append(1))
    keeper.save([1])
    keeper.save([2])
    keeper.close()
    assert len(saved) == 2
    for number in (0, 1):
        file = SHARED_MEMORY / slot.name(number)
        file.unlink() if how == "removed" else slot.scribble(number, 0, bytes(file.stat().st_size))
    again = CheckpointKeeper(slot.start(is_expected=bool(saved)), None, logging.getLogger("module"))
    assert (again.restored, again.lost) == (None, 1)
    assert "none is left" in caplog.text
    again.save([3])
    assert start(every_s=None).lost == 0


def test_state_none_is_a_fresh_start(start: Starter) -> None:
    keeper = start(every_s=None)
    keeper.save([1])
    keeper.save(None)
    assert start(every_s=None).restored is None


def test_without_persist_nothing_is_on_disk(start: Starter, path: Path) -> None:
    keeper = start(every_s=None)
    keeper.save([1])
    keeper.close()
    assert list(path.parent.iterdir()) == []


def test_refused_state_leaves_the_previous_one(start: Starter) -> None:
    keeper = start(every_s=None, limit_bytes=4096)
    keeper.save([1])
    with pytest.raises(CheckpointTooLarge):
        keeper.save(np.zeros(10_000))
    with pytest.raises(UnsupportedState):
        keeper.save({1, 2})
    assert start(every_s=None).restored == [1]


def test_full_memory_is_counted_and_logged_ever_more_rarely(
    start: Starter, caplog: pytest.LogCaptureFixture, request: pytest.FixtureRequest
) -> None:
    keeper = start(every_s=None)
    keeper.save([1])
    request.getfixturevalue("full_memory")
    assert [keeper.save([2]) for _ in range(10)] == [False] * 10
    assert keeper.refused == 10
    assert [
        record.args[0] for record in caplog.records if isinstance(record.args, tuple) and record.args
    ] == [1, 2, 4, 8]
    assert start(every_s=None).restored == [1]


def test_next_run_continues_from_disk(start: Starter, slot: SlotOfARun, path: Path) -> None:
    keeper = start()
    for number in range(5):
        keeper.save({"number": number})
    keeper.close()
    assert on_disk(path) == {"number": 4}
    slot.forget()
    assert start().restored == {"number": 4}


def test_memory_of_this_run_is_newer_than_the_disk(start: Starter, path: Path) -> None:
    write_file(path, encode("old"))
    keeper = start()
    assert keeper.restored == "old"
    keeper.save("new")
    keeper.close()
    write_file(path, encode("old"))
    assert start().restored == "new"


def test_next_incarnation_writes_what_a_killed_process_did_not(start: Starter, path: Path) -> None:
    start(every_s=None).save("new")  # as if killed before its thread came to it
    assert on_disk(path) is None
    start().close()
    assert on_disk(path) == "new"


def test_module_does_not_wait_for_the_disk_and_the_newest_state_is_written(
    start: Starter, slow_disk: SlowDisk
) -> None:
    keeper = start(every_s=0.0)
    keeper.save(0)
    assert slow_disk.began.wait(10)
    for number in range(1, 100):
        assert keeper.save(number)
    assert slow_disk.written == []
    slow_disk.release()
    keeper.close()
    assert slow_disk.written == [0, 99]


def test_disk_is_written_at_most_once_per_period_and_at_the_end(start: Starter, slow_disk: SlowDisk) -> None:
    keeper = start(every_s=NEVER_S)
    slow_disk.release()
    keeper.save(0)
    assert slow_disk.began.wait(10)
    for number in range(1, 100):
        keeper.save(number)
    keeper.close()
    assert len(slow_disk.written) == 2
    assert slow_disk.written[-1] == 99


def test_full_disk_is_logged_and_the_module_continues(
    start: Starter, path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(_fd: int) -> None:
        raise OSError(28, "No space left on device")

    keeper = start()
    with monkeypatch.context() as full:
        full.setattr(os, "fsync", refuse)
        assert keeper.save([1])
        keeper.close()
    assert "not be written to disk: [Errno 28] No space" in caplog.text
    assert on_disk(path) is None


@pytest.mark.parametrize(
    ("content", "why"), [(b"garbage", "damaged"), (encode([1])[:8] + b"\7" + encode([1])[9:], "too-new")]
)
def test_invalid_file_is_logged_and_set_aside(
    start: Starter, path: Path, caplog: pytest.LogCaptureFixture, content: bytes, why: str
) -> None:
    path.write_bytes(content)
    keeper = start()
    assert keeper.restored is None
    assert "starts fresh" in caplog.text
    assert f"kept as {path}.{why}" in caplog.text
    assert Path(f"{path}.{why}").read_bytes() == content
    keeper.save([2])
    keeper.close()
    assert on_disk(path) == [2]


def test_unreadable_file_is_logged(start: Starter, path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path.mkdir()
    assert start().restored is None
    assert f"starts fresh: {path} cannot be read" in caplog.text


def test_damaged_memory_is_logged_and_does_not_damage_the_file(
    start: Starter, slot: SlotOfARun, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    keeper = start()
    keeper.save("good")
    keeper.close()
    keeper = start(every_s=None)
    keeper.save("bad")
    keeper.save("bad")
    for number in (0, 1):
        slot.damage(number, IMAGE_BEGIN + 40)
    assert start().restored == "good"
    assert caplog.text.count("is lost") == 2
