"""A repair gives a valid file with every message of every complete chunk, or fails and leaves none."""

import errno
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from robbie_mp.logs.recording.errors import LogError, LogNotWritten, NotALog, RepairFailed
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.logs.recording.repair import Repair, repair, repaired_name, unwatched
from tests.logs.recording._support.logs import START_NS, write_log, write_small_log
from tests.logs.recording.test_reader import FORMS

Told = list[tuple[str, int, int, int, bytes]]


def repaired(source: Path, target: Path) -> Repair:
    return repair(source, target, unwatched)


def read_by_mcap(path: Path) -> Told:
    """All messages, by the library, which uses the index and checks all checksums."""
    with path.open("rb") as file:
        return [
            (channel.topic, message.sequence, message.log_time, message.publish_time, message.data)
            for _, channel, message in make_reader(file, validate_crcs=True).iter_messages(
                log_time_order=False
            )
        ]


def ends_of_durable_units(path: Path, form: str) -> list[tuple[int, int]]:
    """Where chunks (or messages outside of chunks) end, and how many messages there are up to there."""
    ends, count = [], 0
    with open_log(path) as log:
        part = log.parts[0]
        for block in part.contents.blocks:
            messages = list(part._messages_of(block))
            if form == "without chunks":
                end = block.frame.start
                for message in messages:
                    count += 1
                    end = path.read_bytes().index(message.data, end) + len(message.data)
                    ends.append((end, count))
            else:
                count += len(messages)
                ends.append((block.frame.end, count))
    return ends


@pytest.fixture
def quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk on which many files are synchronised in no time."""
    monkeypatch.setattr(os, "fsync", lambda _fd: None)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_disk")
@pytest.mark.parametrize(
    ("form", "step"),
    [("zstd", 1), ("without chunks", 3), ("plain", 11), ("lz4", 11), ("without checksums", 11)],
)
def test_repair_of_a_log_cut_at_any_byte_keeps_every_complete_chunk(
    tmp_path: Path, form: str, step: int
) -> None:
    path = write_small_log(tmp_path / "a.mcap", **FORMS[form])
    whole, messages = path.read_bytes(), read_by_mcap(path)
    ends = ends_of_durable_units(path, form)
    assert ends[-1][1] == len(messages) and len(ends) > 2
    cut, target = tmp_path / "cut.mcap", tmp_path / "repaired.mcap"
    for size in range(len(whole), 0, -step):
        cut.write_bytes(whole[:size])
        done = repaired(cut, target)
        expected = max([count for end, count in ends if end <= size], default=0)
        assert read_by_mcap(target) == messages[:expected], size
        assert (done.messages, bool(done.damage)) == (expected, size < len(whole))
        assert cut.read_bytes() == whole[:size]
        target.unlink()


@pytest.mark.usefixtures("quick_disk")
def test_repair_of_a_large_log_cut_at_random_keeps_every_complete_chunk(
    tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    """With --exhaustive at 2,000 bytes."""
    path = write_log(tmp_path / "a.mcap", 3000, compression=CompressionType.ZSTD, chunk_size=30_000)
    whole, messages = path.read_bytes(), read_by_mcap(path)
    ends = ends_of_durable_units(path, "zstd")
    choice = random.Random(6)
    cut, target = tmp_path / "cut.mcap", tmp_path / "repaired.mcap"
    for size in choice.sample(range(1, len(whole)), 2000 if pytestconfig.getoption("--exhaustive") else 5):
        cut.write_bytes(whole[:size])
        repaired(cut, target)
        expected = max([count for end, count in ends if end <= size], default=0)
        assert read_by_mcap(target) == messages[:expected], size
        target.unlink()


@pytest.mark.usefixtures("quick_disk")
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_repair_with_any_changed_bytes_is_valid_or_leaves_nothing(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("logs")
    form = data.draw(st.sampled_from(sorted(set(FORMS) - {"without channels in its summary"})))
    source, target = write_log(folder / "a.mcap", 9, **FORMS[form]), folder / "b.mcap"
    content, messages = bytearray(source.read_bytes()), read_by_mcap(source)
    changes = st.tuples(st.integers(0, len(content) - 1), st.integers(0, 255))
    for at, value in data.draw(st.lists(changes, min_size=1, max_size=4)):
        content[at] = value
    source.write_bytes(content)
    try:
        done = repaired(source, target)
    except LogError:
        assert not target.exists()
        return
    kept = read_by_mcap(target)
    assert len(kept) == done.messages
    if form in ("plain", "zstd", "lz4"):  # where checksums tell
        assert [one[1:] for one in kept] == [
            one[1:] for one in messages if one[1] in {one[1] for one in kept}
        ]


def test_messages_after_a_damaged_chunk_are_kept(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", 30)
    messages, whole = read_by_mcap(path), path.read_bytes()
    with open_log(path) as log:
        part = log.parts[0]
        block = part.contents.blocks[4]
        lost = {message.sequence for message in part._messages_of(block)}
    for at in (block.frame.start - 9, block.frame.start - 5, block.frame.start + 200):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        done = repaired(path, tmp_path / "b.mcap")
        assert len(done.damage) == 1 and str(block.frame.start - 9) in done.damage[0]
        assert read_by_mcap(tmp_path / "b.mcap") == [one for one in messages if one[1] not in lost]
        (tmp_path / "b.mcap").unlink()


def test_messages_of_an_undescribed_channel_are_skipped_and_counted(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", 30)
    messages, whole = read_by_mcap(path), path.read_bytes()
    with open_log(path) as log:
        part = log.parts[0]
        first, *others = ([m.sequence for m in part._messages_of(b)] for b in part.contents.blocks)
        at = part.contents.blocks[0].frame.start + 100
    damaged = whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]
    path.write_bytes(damaged)  # the summary describes them, too
    assert repaired(path, tmp_path / "b.mcap").messages == 30 - len(first)
    path.write_bytes(damaged[:-1])
    done = repaired(path, tmp_path / "c.mcap")
    kept = {one[1] for one in read_by_mcap(tmp_path / "c.mcap")}
    assert done.messages == len(kept) < 30 - len(first) == sum(map(len, others))
    lost = 30 - len(first) - len(kept)
    assert done.damage[-1] == f"{lost} messages belong to channels whose description is lost"
    assert {one[1] for one in messages} > kept


def test_unrecognizable_chunk_is_reported_if_the_summary_counts_its_messages(
    tmp_path: Path,
) -> None:
    path = write_log(tmp_path / "a.mcap", 30)
    with open_log(path) as log:
        at = log.parts[0].contents.blocks[4].frame.start - 9
    content = bytearray(path.read_bytes())
    content[at] |= 0x80  # a record that anybody may add
    path.write_bytes(content)
    done = repaired(path, tmp_path / "b.mcap")
    assert done.damage == [f"the summary counts 30 messages, but there are {done.messages}"]


def test_long_sequences_of_messages_outside_of_chunks_are_read_in_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robbie_mp.logs.recording.scan.ROW_BYTES", 1000)
    path = write_log(tmp_path / "a.mcap", 30, use_chunking=False)
    with open_log(path) as log:
        assert max(block.frame.length for block in log.parts[0].contents.blocks) < 2000
        assert len(list(log.messages())) == 30


def test_damaged_attachment_is_skipped(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_attachment(1, 2, "note.txt", "text/plain", b"hello")
        writer.finish()  # type: ignore[no-untyped-call]
    content = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(content.replace(b"hello", b"hullo"))
    done = repaired(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert "'note.txt' does not match its checksum" in done.damage[0]
    with (tmp_path / "b.mcap").open("rb") as file:
        assert not list(make_reader(file).iter_attachments())


def test_metadata_attachments_and_channels_without_messages_are_kept(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "somebody else")
        writer.add_metadata("about", {"a": "b"})
        writer.add_attachment(1, 2, "note.txt", "text/plain", b"hello")
        schema = writer.register_schema("a/msg/B", "ros2msg", b"int8 x")
        used = writer.register_channel("/used", "cdr", schema, {"c": "d"})
        writer.register_channel("/unused", "json", 0)
        writer.add_message(used, START_NS, b"\0\1\0\0\5", START_NS + 1, 7)
        writer.finish()  # type: ignore[no-untyped-call]
    done = repaired(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert (done.messages, done.damage) == (1, [])
    with (tmp_path / "b.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert [(one.topic, one.metadata) for one in summary.channels.values()] == [
            ("/used", {"c": "d"}), ("/unused", {})]  # fmt: skip
        assert [(one.name, one.metadata) for one in reader.iter_metadata()] == [("about", {"a": "b"})]
        assert [(one.name, one.data) for one in reader.iter_attachments()] == [("note.txt", b"hello")]
        assert reader.get_header().library == "somebody else"
    assert read_by_mcap(tmp_path / "b.mcap") == [("/used", 7, START_NS, START_NS + 1, b"\0\1\0\0\5")]


def test_folder_shows_the_repaired_part_in_place_of_the_old_one(tmp_path: Path) -> None:
    write_log(tmp_path / "run_0000.mcap", 6)
    cut = write_log(tmp_path / "run_0001.mcap", 6)
    cut.write_bytes(cut.read_bytes()[:-100])
    with open_log(tmp_path) as log:
        assert not log.is_complete
    repaired(cut, repaired_name(cut))
    with open_log(tmp_path) as log:
        assert log.is_complete and sum(log.counts.values()) == 12
        assert [part.path.name for part in log.parts] == ["run_0000.mcap", "run_0001.repaired.mcap"]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", 6)
    content = path.read_bytes()
    for target in (path, write_log(tmp_path / "b.mcap", 6)):
        with pytest.raises(LogNotWritten, match="cannot be written: File exists"):
            repaired(path, target)
        assert target.read_bytes() == content


@pytest.mark.parametrize(
    "spoil",
    [
        lambda written: written[:1000] + bytes([written[1000] ^ 1]) + written[1001:],
        lambda written: written[:-8],
    ],
)
def test_result_that_reads_differently_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spoil: Callable[[bytes], bytes]
) -> None:
    path, target = write_log(tmp_path / "a.mcap", 12), tmp_path / "b.mcap"

    def finish_on_a_bad_disk(writer: Any) -> None:
        finish(writer)  # type: ignore[no-untyped-call]
        file = writer._Writer__stream
        file.seek(0)
        written = file.read()
        file.seek(0)
        file.truncate()
        file.write(spoil(written))

    finish = Writer.finish
    monkeypatch.setattr(Writer, "finish", finish_on_a_bad_disk)
    with pytest.raises(RepairFailed, match="it was removed"):
        repaired(path, target)
    assert not target.exists()


def test_result_that_is_valid_but_different_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, target = write_log(tmp_path / "a.mcap", 12), tmp_path / "b.mcap"
    monkeypatch.setattr(Writer, "add_message", lambda *_: None)
    with pytest.raises(RepairFailed, match="does not contain the written data"):
        repaired(path, target)
    assert not target.exists()


def test_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_fd: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    path = write_log(tmp_path / "a.mcap", 6)
    with pytest.raises(LogNotWritten, match="No space left on device"):
        repaired(path, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_unwritable_folders_and_empty_files_are_reported(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", 6)
    with pytest.raises(LogNotWritten, match="No such file or directory"):
        repaired(path, tmp_path / "none" / "b.mcap")
    path.write_bytes(b"")
    with pytest.raises(NotALog, match="is empty"):
        repaired(path, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()
