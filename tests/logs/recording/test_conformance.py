"""Every file of MCAP's conformance suite is complete, has its records, and is repaired without a loss."""

import hashlib
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader
from mcap.records import Attachment, Message, Metadata

from robbie_mp.logs.recording.part import LogPart
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.logs.recording.repair import repair, unwatched
from tests.logs.recording._support.conformance import PUBLISHED, Variant, variants, written

VARIANTS = sorted(variants(), key=lambda variant: variant.name)
PADDED = [variant for variant in VARIANTS if "pad" in variant.features]
Told = tuple[list[Message], list[Attachment], list[Metadata]]


def in_suite(variant: Variant) -> Told:
    records = variant.records
    return (
        [one for one in records if isinstance(one, Message)],
        [one for one in records if isinstance(one, Attachment)],
        [one for one in records if isinstance(one, Metadata)],
    )


def read(part: LogPart) -> Told:
    messages = [
        Message(one.channel_id, one.time_ns, one.data, one.publish_time_ns, one.sequence)
        for one in part.messages()
    ]
    return messages, list(part.attachments()), part.contents.metadata


def read_by_mcap(path: Path) -> Told:
    """All records, by the library's reader that uses no index: with one, it finds only what is in it."""
    with path.open("rb") as file:
        messages = NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False)
        found = [message for _, _, message in messages]
    with path.open("rb") as file:
        attachments = list(NonSeekingReader(file).iter_attachments())
    with path.open("rb") as file:
        return found, attachments, list(NonSeekingReader(file).iter_metadata())


def test_suite_is_the_published_one() -> None:
    digests = (hashlib.sha256(written(variant)).hexdigest() for variant in VARIANTS)
    assert len(VARIANTS) == 416
    assert hashlib.sha256("".join(digests).encode()).hexdigest() == PUBLISHED


@pytest.mark.parametrize("trust_summary", [True, False])
def test_every_file_is_complete_and_has_its_records(tmp_path: Path, trust_summary: bool) -> None:
    path = tmp_path / "a.mcap"
    for variant in VARIANTS:
        path.write_bytes(written(variant))
        with LogPart(path, trust_summary=trust_summary) as part:
            assert read(part) == in_suite(variant), variant.name
            assert part.is_complete, (variant.name, part.contents.damage)
            assert part.contents.message_count == len(in_suite(variant)[0]), variant.name


def test_library_reads_the_same(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for variant in VARIANTS:
        path.write_bytes(written(variant))
        with LogPart(path) as part:
            assert read(part) == read_by_mcap(path), variant.name


@pytest.mark.parametrize("padding", [b"\0", b"\5" * 40, b"\xff" * 200], ids=len)
def test_every_record_that_may_have_more_bytes_may_have_any(tmp_path: Path, padding: bytes) -> None:
    path = tmp_path / "a.mcap"
    for variant in PADDED:
        path.write_bytes(written(variant, padding, padding))
        with LogPart(path, trust_summary=False) as part:
            assert read(part) == in_suite(variant), variant.name
            assert part.is_complete, (variant.name, part.contents.damage)


def test_chunk_with_more_bytes_is_found_behind_a_damaged_place(tmp_path: Path) -> None:
    data = written(Variant("TenMessages", frozenset({"ch", "pad"})), padding_in_chunks=b"\1\2")
    header_end = 8 + 9 + 8 + 3
    (tmp_path / "a.mcap").write_bytes(data[:header_end] + b"\x05\xff\xff\xff" + data[header_end:])
    with open_log(tmp_path / "a.mcap") as log:
        assert not log.is_complete
        assert len(list(log.messages())) == 10


@pytest.mark.slow
def test_repair_loses_nothing(tmp_path: Path) -> None:
    path, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    for variant in VARIANTS:
        path.write_bytes(written(variant))
        assert repair(path, target, unwatched).damage == [], variant.name
        with LogPart(target) as part:
            assert read(part) == in_suite(variant), variant.name
        target.unlink()


def test_repair_keeps_attachments_with_more_bytes(tmp_path: Path) -> None:
    variant = Variant("OneAttachment", frozenset({"pad"}))
    (tmp_path / "a.mcap").write_bytes(written(variant))
    repair(tmp_path / "a.mcap", tmp_path / "b.mcap", unwatched)
    with LogPart(tmp_path / "b.mcap") as part:
        assert read(part) == in_suite(variant)
