"""Two logs are equal, or the different and missing messages and the first difference are reported."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp import Header, Message, Time
from robbie_mp.logs.recording import alignment
from robbie_mp.logs.recording.alignment import align
from robbie_mp.logs.recording.comparison import ChannelComparison, ComparisonOptions, compare
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import Odometry, TFMessage, TransformStamped
from tests.logs.recording._support.logs import LogFile, scan, write_log

SEQUENCES = st.lists(st.integers(0, 3), max_size=12)


def compared(
    folder: Path, a: Sequence[Message], b: Sequence[Message], *, ignore_stamps: bool = False
) -> ChannelComparison:
    for name, messages in (("a", a), ("b", b)):
        with LogFile(folder / f"{name}.mcap") as file:
            for number, message in enumerate(messages):
                file.add(message, "t", time_ns=number)
    with open_log(folder / "a.mcap") as log_a, open_log(folder / "b.mcap") as log_b:
        (one,) = compare(log_a, log_b, ComparisonOptions(ignore_stamps=ignore_stamps))
        return one


def figures(one: ChannelComparison) -> tuple[int, int, int, int]:
    return one.equal, one.different, one.only_in_a, one.only_in_b


def test_log_is_equal_to_itself(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap")
    with open_log(path) as a, open_log(path) as b:
        found = compare(a, b)
    assert all(one.is_equal for one in found)
    assert [one.equal for one in found] == [10, 10, 10]


def test_exactly_one_lost_message_is_found(tmp_path: Path) -> None:
    scans = [scan(number) for number in range(20)]
    one = compared(tmp_path, scans, [*scans[:7], *scans[8:]])
    assert figures(one) == (19, 0, 1, 0) and not one.is_equal and one.first is None
    assert figures(compared(tmp_path, scans[1:], scans)) == (19, 0, 0, 1)


def test_first_different_field_is_reported_with_both_values(tmp_path: Path) -> None:
    scans = [scan(number) for number in range(6)]
    other = scan(99, rays=8)
    one = compared(tmp_path, scans, [*scans[:3], other, scans[4], other])
    assert figures(one) == (4, 2, 0, 0)
    assert one.first is not None
    assert (one.first.index, one.first.time_ns) == (3, 3)
    assert (one.first.field, one.first.a, one.first.b) == ("ranges[0]", "3.0", "99.0")


@pytest.mark.parametrize(
    ("a", "b", "field", "texts"),
    [
        (Odometry(child_frame_id="x"), Odometry(child_frame_id="y"), "child_frame_id", ("'x'", "'y'")),
        (scan(1, rays=2), scan(1, rays=3), "ranges", ("2 elements", "3 elements")),
        (scan(1), scan(1, time_ns=5), "header.stamp.sec", ("1700000000", "0")),
        (
            TFMessage(transforms=[TransformStamped(), TransformStamped(child_frame_id="x")]),
            TFMessage(transforms=[TransformStamped(), TransformStamped(child_frame_id="y")]),
            "transforms[1].child_frame_id",
            ("'x'", "'y'"),
        ),
    ],
)
def test_fields_are_named_by_their_paths(
    tmp_path: Path, a: Message, b: Message, field: str, texts: tuple[str, str]
) -> None:
    first = compared(tmp_path, [a], [b]).first
    assert first is not None and (first.field, (first.a, first.b)) == (field, texts)


@pytest.mark.parametrize(
    ("a", "b", "field", "texts"),
    [
        (b"\0\1\0\0\0\0\0\0", b"\0\1\0\0\0\0\0\x80", "x", ("0.0", "-0.0")),
        (b"\0\1\0\0\0\0\0\0", b"\0\1\0\3\0\0\0\0", "", ("byte 3 of 8", "byte 3 of 8")),
        (b"\0\1\0\0", b"\0\1\0\0\0\0\0\0", "", ("byte 4 of 4", "byte 4 of 8")),
    ],
)
def test_different_bytes_of_equal_values_count_as_different(
    tmp_path: Path, a: bytes, b: bytes, field: str, texts: tuple[str, str]
) -> None:
    for name, data in (("a", a), ("b", b)):
        with LogFile(tmp_path / f"{name}.mcap") as file:
            file.add_bytes(file.channel("a/msg/B", "float32 x", 1, "t", "s"), data, 0)
    with open_log(tmp_path / "a.mcap") as log_a, open_log(tmp_path / "b.mcap") as log_b:
        (one,) = compare(log_a, log_b)
    assert one.first is not None and (one.first.field, (one.first.a, one.first.b)) == (field, texts)


def test_stamps_are_ignored_on_request_and_nothing_else(tmp_path: Path) -> None:
    def transforms(sec: int, frame: str) -> TFMessage:
        header = Header(stamp=Time(sec=sec), frame_id=frame)
        return TFMessage(transforms=[TransformStamped(header=header)])

    for a, same, other in (
        (scan(1, 1), scan(1, 2), scan(2, 2)),
        (transforms(1, "x"), transforms(2, "x"), transforms(2, "y")),
    ):
        assert not compared(tmp_path, [a], [same]).is_equal
        assert compared(tmp_path, [a], [same], ignore_stamps=True).is_equal
        one = compared(tmp_path, [a], [other], ignore_stamps=True)
        assert one.first is not None and "stamp" not in one.first.field


def test_channels_that_only_one_log_has_are_reported(tmp_path: Path) -> None:
    for name in ("a", "b"):
        with LogFile(tmp_path / f"{name}.mcap") as file:
            file.add(scan(1), "both")
            file.add(scan(2), f"only in {name}")
    with open_log(tmp_path / "a.mcap") as log_a, open_log(tmp_path / "b.mcap") as log_b:
        found = {one.channel.topic: figures(one) for one in compare(log_a, log_b)}
        assert found == {"both": (1, 0, 0, 0), "only in a": (0, 0, 1, 0), "only in b": (0, 0, 0, 1)}
        assert [one.channel.topic for one in compare(log_a, log_b, ComparisonOptions(["bo*"]))] == ["both"]


@given(SEQUENCES, SEQUENCES)
def test_alignment_covers_both_sequences_and_finds_the_longest_common_part(
    a: list[int], b: list[int]
) -> None:
    spans = list(align(a, b))
    assert [a[at] for span in spans for at in range(span.a_from, span.a_to)] == a
    assert [b[at] for span in spans for at in range(span.b_from, span.b_to)] == b
    common = 0
    for span in spans:
        if span.is_equal:
            assert a[span.a_from : span.a_to] == b[span.b_from : span.b_to] != []
            common += span.a_to - span.a_from
    assert common == longest_common(a, b)


def longest_common(a: list[int], b: list[int]) -> int:
    """Length of the longest common subsequence, by the textbook."""
    lengths = [[0] * (len(b) + 1) for _ in range(len(a) + 1)]
    for i, one in enumerate(a):
        for j, other in enumerate(b):
            best = max(lengths[i][j + 1], lengths[i + 1][j])
            lengths[i + 1][j + 1] = lengths[i][j] + 1 if one == other else best
    return lengths[-1][-1]


def test_sequences_with_too_little_in_common_are_compared_by_position(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(alignment, "EDIT_LIMIT", 3)
    spans = list(align([1, 2, 3, 4, 5], [9, 2, 8, 4, 7, 6]))
    assert [tuple(span)[:4] for span in spans if span.is_equal] == [(1, 2, 1, 2), (3, 4, 3, 4)]
    assert (spans[-1].a_to, spans[-1].b_to) == (5, 6)


def test_messages_of_other_senders_are_equal_on_request(tmp_path: Path) -> None:
    for name, senders in (("a", ["laser", "laser"]), ("b", ["playback", "other"])):
        with LogFile(tmp_path / f"{name}.mcap") as file:
            for number, sender in enumerate(senders):
                file.add(scan(number), "t", sender, time_ns=number)
            file.add(scan(9), "late", senders[0], time_ns=9)
    with open_log(tmp_path / "a.mcap") as a, open_log(tmp_path / "b.mcap") as b:
        assert not any(one.is_equal for one in compare(a, b))
        found = compare(a, b, ComparisonOptions(ignore_sender=True))
    assert [(one.channel.topic, one.channel.sender) for one in found] == [("t", None), ("late", None)]
    assert [figures(one) for one in found] == [(2, 0, 0, 0), (1, 0, 0, 0)]


def test_difference_between_messages_of_other_senders_is_reported(tmp_path: Path) -> None:
    for name, sender, last in (("a", "laser", 2), ("b", "playback", 3)):
        with LogFile(tmp_path / f"{name}.mcap") as file:
            for number in (0, 1, last):
                file.add(scan(number), "t", sender, time_ns=number)
    with open_log(tmp_path / "a.mcap") as a, open_log(tmp_path / "b.mcap") as b:
        (one,) = compare(a, b, ComparisonOptions(ignore_sender=True))
    assert figures(one) == (2, 1, 0, 0)
    assert one.first is not None and (one.first.a, one.first.b) == ("2.0", "3.0")


def test_excluded_channels_are_not_compared(tmp_path: Path) -> None:
    for name, number in (("a", 1), ("b", 2)):
        with LogFile(tmp_path / f"{name}.mcap") as file:
            file.add(scan(0), "same")
            file.add(scan(number), "other/scan")
            file.add(Odometry(child_frame_id=name), "")
    with open_log(tmp_path / "a.mcap") as a, open_log(tmp_path / "b.mcap") as b:
        found = compare(a, b, ComparisonOptions(exclude=["other/*", "Odometry"]))
        assert [one.channel.topic for one in found] == ["same"]
        found = compare(a, b, ComparisonOptions(["*/scan", "same"], ["other/*"]))
        assert [one.channel.topic for one in found] == ["same"]
