"""A recorder's counts outlive its process: what it had received and not written is known to the next one."""

from pathlib import Path

import pytest

from robbie_mp.logs.capture import tally as module
from robbie_mp.logs.capture.tally import Tally, UnendedParts
from robbie_mp.logs.recording.format import ChannelKey, RecordedCount
from tests.logs.recording._support.logs import write_log

ONE, TWO = ChannelKey("a/msg/A", 1, "one", "s"), ChannelKey("a/msg/A", 1, "two", "s")


def counted(
    folder: Path, received: dict[ChannelKey, int], missed: dict[ChannelKey, int] | None = None
) -> Tally:
    """A process of the recorder that has counted some messages."""
    tally = Tally(folder, "logger")
    for key, count in received.items():
        for _ in range(count):
            tally.receive(key)
    for key, count in (missed or {}).items():
        tally.miss(key, count)
    return tally


def test_messages_in_no_part_are_lost(tmp_path: Path) -> None:
    counted(tmp_path, {ONE: 5, TWO: 3}, {TWO: 2})
    tally = Tally(tmp_path, "logger")
    assert tally.lost_before({ONE: RecordedCount(3), TWO: RecordedCount(3, 2)}, 1) == {ONE: 2}


def test_ended_parts_are_not_read_again(tmp_path: Path) -> None:
    first = counted(tmp_path, {ONE: 5})
    assert first.lost_before({}, 0) == {}
    first.end_part(0, {ONE: RecordedCount(4, 0)})
    second = Tally(tmp_path, "logger")
    assert second.next_part == 1
    assert second.lost_before({}, 1) == {ONE: 1}


def test_loss_is_counted_again_until_a_part_counts_it(tmp_path: Path) -> None:
    counted(tmp_path, {ONE: 5})
    assert Tally(tmp_path, "logger").lost_before({ONE: RecordedCount(3)}, 1) == {ONE: 2}
    third = Tally(tmp_path, "logger")  # the one before was killed before its part counted it
    assert third.next_part == 1
    assert third.lost_before({}, 2) == {ONE: 2}
    third.end_part(2, {ONE: RecordedCount(0, 2)})
    fourth = Tally(tmp_path, "logger")
    assert fourth.next_part == 3
    assert fourth.lost_before({}, 3) == {}


def test_part_that_ends_before_the_past_is_known_is_counted(tmp_path: Path) -> None:
    counted(tmp_path, {ONE: 5})
    second = counted(tmp_path, {ONE: 4})
    second.end_part(1, {ONE: RecordedCount(4)})
    assert second.lost_before({ONE: RecordedCount(4)}, 1) == {ONE: 1}
    second.end_part(2, {ONE: RecordedCount(0, 1)})
    assert Tally(tmp_path, "logger").lost_before({}, 3) == {}


def test_channels_beyond_the_limit_are_counted_as_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_CHANNELS", 1)
    counted(tmp_path, {ONE: 1, TWO: 2, TWO._replace(topic="three"): 3})
    assert Tally(tmp_path, "logger").lost_before({TWO: RecordedCount(1)}, 1) == {ONE: 1, module.OTHERS: 4}


def test_parts_without_an_end_are_read(tmp_path: Path) -> None:
    folder = tmp_path / "log"
    folder.mkdir()
    for number in range(3):
        path = write_log(folder / f"log_{number:04}.mcap")
        path.write_bytes(path.read_bytes()[:-6000])
    (folder / "log_0003.mcap").touch()
    found = UnendedParts(folder, 1).counts(wait_s=20.0)
    (folder / "log_0000.mcap").unlink()
    every = UnendedParts(folder, 0).counts(wait_s=20.0)
    assert found == every and found is not None
    assert 0 < sum(count.recorded for count in found.values()) <= 60
    none = UnendedParts(tmp_path / "none", 0)
    assert (none.counts(wait_s=20.0), none.after) == ({}, 0)
    assert UnendedParts(folder, 1).after == 4
