"""Clips on a disk that is full, in folders that are links, of rings that were cut or forged."""

import errno
import logging
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_mp.logs.black_box import clip_folder, clip_writer
from robbie_mp.logs.black_box.clip_folder import PINNED, AboutClip, ClipFolder, clip_name, saved_clips
from robbie_mp.logs.black_box.clip_writer import ClipResult, ClipWriter
from robbie_mp.logs.black_box.large_messages import LargeMessages
from robbie_mp.logs.black_box.state import MAX_CLIP_S, MAX_TRIGGERS, BoxState, OpenClip
from robbie_mp.logs.recording.appended_file import AppendedFile
from robbie_mp.logs.recording.format import ChannelKey, part_path
from robbie_mp.logs.recording.reader import open_log
from robbie_mp.messages import CompressedImage, Image, PointCloud2
from tests._support.robot import wait_until
from tests.logs.recording._support.logs import write_log

ABOUT = AboutClip("12345678", "robot", ["mark: x"], [0.0], 0, "")


def ring_of(folder: Path, parts: int) -> Path:
    """Write a ring with whole parts."""
    ring = folder / "ring"
    ring.mkdir(parents=True)
    for number in range(parts):
        write_log(part_path(ring, number))
    return ring


def written(folder: ClipFolder, ring: Path, name: str, parts: int) -> Path:
    for number in range(parts):
        folder.add_part(name, part_path(ring, number), number)
    folder.finish(name, ABOUT)
    return folder.path / name


def test_clip_is_a_log_of_all_its_parts(tmp_path: Path) -> None:
    ring = ring_of(tmp_path, 2)
    clip = written(ClipFolder(tmp_path / "out", 1 << 30), ring, clip_name("mark: It fell!", ()), 2)
    assert clip.name.endswith("Z-mark-it-fell")
    with open_log(ring) as of_ring, open_log(clip) as of_clip:
        assert of_clip.is_complete
        assert [one.data for one in of_clip.messages()] == [one.data for one in of_ring.messages()]


def test_clip_is_described_after_all_else_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    described_before: list[bool] = []
    folder, ring = ClipFolder(tmp_path / "out", 1 << 30), ring_of(tmp_path, 1)

    def write(clip: Path) -> None:
        described_before.append(saved_clips([folder.path])[0].about is not None)
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(clip_folder, "write_bag_metadata", write)
    written(folder, ring, clip_name("x", ()), 1)
    assert described_before == [False]
    assert saved_clips([folder.path])[0].about == ABOUT


def test_part_of_a_killed_writer_is_completed(tmp_path: Path) -> None:
    ring = ring_of(tmp_path, 1)
    part = part_path(ring, 0)
    part.write_bytes(part.read_bytes()[:-40])
    clip = written(ClipFolder(tmp_path / "out", 1 << 30), ring, clip_name("x", ()), 1)
    with open_log(clip) as log:
        assert log.is_complete and log.message_count


@pytest.mark.parametrize("forged", [b"", b"no log", b"\x89MCAP0\r\n" + bytes(range(256)) * 99])
def test_forged_part_harms_nothing(tmp_path: Path, forged: bytes) -> None:
    ring = ring_of(tmp_path, 1)
    part_path(ring, 1).write_bytes(forged)
    clip = written(ClipFolder(tmp_path / "out", 1 << 30), ring, clip_name("x", ()), 2)
    assert part_path(clip, 1).exists()
    with open_log(part_path(clip, 0)) as log:
        assert log.message_count


def test_links_and_pipes_are_not_followed(tmp_path: Path) -> None:
    ring = ring_of(tmp_path, 1)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (tmp_path / "secret").write_text("secret")
    part_path(ring, 1).symlink_to(tmp_path / "secret")
    os.mkfifo(part_path(ring, 2))
    folder = ClipFolder(tmp_path / "out", 1 << 30)
    for number in (1, 2):
        with pytest.raises((OSError, LookupError)):
            folder.add_part("20261128T000000Z-x", part_path(ring, number), number)
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "clips").symlink_to(elsewhere)
    with pytest.raises(OSError, match="links to folders are not followed"):
        ClipFolder(tmp_path / "linked", 1 << 30).add_part("20261128T000000Z-x", part_path(ring, 0), 0)
    assert not list(elsewhere.iterdir())


def test_oldest_clip_that_is_not_pinned_makes_room(tmp_path: Path) -> None:
    ring = ring_of(tmp_path, 1)
    size = part_path(ring, 0).stat().st_size
    folder = ClipFolder(tmp_path / "out", 3 * size + size // 2)
    names = [f"2026112{day}T000000Z-x" for day in range(4)]
    for name in names[:2]:
        folder.add_part(name, part_path(ring, 0), 0)
    (folder.path / names[0] / PINNED).touch()
    for name in names[2:]:
        folder.add_part(name, part_path(ring, 0), 0)
    assert [clip.folder.name for clip in saved_clips([folder.path])] == [names[0], *names[2:]]
    assert folder.removed == 1
    for name in names:
        if (folder.path / name).exists():
            (folder.path / name / PINNED).touch()
    with pytest.raises(OSError, match="pinned clips use"):
        folder.add_part("20261129T000000Z-x", part_path(ring, 0), 0)


def test_full_disk_takes_older_clips_and_then_the_trigger_is_missed_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ring = ring_of(tmp_path, 1)
    folder = ClipFolder(tmp_path / "out", 1 << 30)
    written(folder, ring, "20261120T000000Z-old", 1)

    def full(_file: AppendedFile, _pieces: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(AppendedFile, "append", full)
    monkeypatch.setattr(clip_writer, "GIVE_UP_S", 0.0)
    monkeypatch.setattr(clip_writer, "RETRY_S", 0.05)
    writer = ClipWriter(ring, folder, "12345678", "robot", logging.getLogger(__name__))
    clip = OpenClip("20261128T000000Z-x", 0, 0, 0, 0, ["mark: x"], 0, [0.0])
    writer.copy(clip, {0}, is_whole=True)
    wait_until(lambda: bool(writer.results))
    assert list(writer.results) == [ClipResult(clip, 0, "No space left on device")]
    assert folder.removed == 1
    assert writer.close(5)


def test_part_that_the_ring_has_no_longer_is_told(tmp_path: Path) -> None:
    ring = ring_of(tmp_path, 1)
    folder = ClipFolder(tmp_path / "out", 1 << 30)
    writer = ClipWriter(ring, folder, "12345678", "robot", logging.getLogger(__name__))
    clip = OpenClip("20261128T000000Z-x", 0, 0, 0, 1, ["mark: x"], 0, [0.0])
    writer.copy(clip, {0, 1}, is_whole=True)
    assert writer.close(5)
    (result,) = writer.results
    assert result.missing == "the ring had 1 of its parts no longer"
    (saved,) = saved_clips([folder.path])
    assert saved.about is not None and saved.about.missing == result.missing


def test_every_trigger_is_counted_once() -> None:
    state = BoxState()
    clip = OpenClip("20261128T000000Z-x", 0, 0, 0)
    state.open.append(clip)
    for number in range(200):
        clip.add(f"trigger {number}", number, float(number), 5.0)
        clip.add(f"trigger {number}", number, float(number), 5.0)
    assert len(clip.triggers) == MAX_TRIGGERS and clip.count == state.triggers == 400
    state.miss(clip.count, "disk full")
    state.open = []
    assert state.triggers == 400


@given(st.binary() | st.text().map(str.encode))
def test_any_state_file_can_be_read(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("state") / "state.json"
    path.write_bytes(data)
    state, problem = BoxState.load(path)
    assert state == BoxState()
    assert problem or data.lstrip().startswith(b"{"), (
        "an empty object is a state in which nothing has happened"
    )


@pytest.mark.parametrize("name", ["../../evil", "/etc", "", "20261128T000000Z-x/../y"])
def test_forged_name_of_a_clip_is_refused(tmp_path: Path, name: str) -> None:
    BoxState(open=[OpenClip(name, 0, 0, 0)]).save(tmp_path / "state.json")
    state, problem = BoxState.load(tmp_path / "state.json")
    assert not state.open and "was changed" in problem


def test_state_outlives_its_process(tmp_path: Path) -> None:
    state = BoxState(open=[OpenClip("20261128T000000Z-x", 1, 2, 3)], seen={"a": (1, 2)}, written=3)
    state.save(tmp_path / "state.json")
    assert BoxState.load(tmp_path / "state.json") == (state, "")


class Clock:
    """A clock that the test sets."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_large_messages_take_a_bounded_share_of_the_ring() -> None:
    clock = Clock()
    large = LargeMessages(0.5, 1e6, 0, clock)
    key, cloud = ChannelKey(PointCloud2.type_name, 1, "cloud", "lidar"), memoryview(bytes(3_000_000))
    taken = 0
    for _ in range(3000):  # 30 s at 100 Hz
        taken += large.take(key, cloud) is not None
        clock.now_s += 0.01
    assert 9 <= taken <= 11


def test_image_becomes_jpeg_with_its_header() -> None:
    pytest.importorskip("PIL")
    import numpy as np  # noqa: PLC0415

    pixels = np.zeros(640 * 480 * 3, np.uint8)
    image = Image(height=480, width=640, step=640 * 3, encoding="rgb8", data=pixels)
    key = ChannelKey(Image.type_name, 1, "camera", "camera")
    kept = LargeMessages(0.5, 1e6, 75).take(key, memoryview(image.encode()))
    assert kept is not None and kept[0].type_name == CompressedImage.type_name
    small = CompressedImage.decode(kept[1])
    assert small.data[:3].tobytes() == b"\xff\xd8\xff" and small.header == image.header
    assert LargeMessages(0.5, 1e6, 75).take(key, memoryview(b"\0\1\0\0nonsense" * 9)) is not None  # as it is


def test_clips_of_another_user_do_not_stop_those_of_this_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    foreign, own = tmp_path / "foreign", tmp_path / "own"
    (foreign / clip_name("x", ())).mkdir(parents=True)
    (own / clip_name("y", ())).mkdir(parents=True)
    iterdir = Path.iterdir

    def refuse(path: Path) -> Iterator[Path]:
        if path == foreign:  # permissions do not stop root, who may run this test
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return iterdir(path)

    monkeypatch.setattr(Path, "iterdir", refuse)
    assert [clip.folder.parent for clip in saved_clips([foreign, own])] == [own]


def test_clip_that_still_collects_takes_further_triggers_up_to_its_longest_time() -> None:
    """On a busy machine each further trigger began a clip of its own, and the ninth had none."""
    clip = OpenClip("20261128T000000Z-x", at_ns=0, until_ns=0, first=0)
    clip.add("bumper ended", 0, 0.0, after_s=1.0)
    over_ns = clip.until_ns + 1
    assert clip.takes(over_ns)
    clip.add("mark: x", over_ns, 1.0, after_s=1.0)
    assert clip.until_ns == over_ns + 1_000_000_000
    assert not clip.takes(round(MAX_CLIP_S * 1e9) + 1)
    clip.last = 3  # all its messages have come
    assert not clip.takes(over_ns)
