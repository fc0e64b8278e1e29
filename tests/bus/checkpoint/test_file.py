"""A checkpoint on disk; tests/bus/checkpoint/_support/killing.py has what happens when its writer dies."""

import os
from pathlib import Path

import pytest

from robbie_mp.bus.checkpoint.errors import CheckpointDamaged, CheckpointTooNew
from robbie_mp.bus.checkpoint.file import (
    CheckpointFileError,
    checkpoint_file,
    read_file,
    set_aside,
    write_file,
)
from robbie_mp.bus.checkpoint.image import encode


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return checkpoint_file(tmp_path, "sim/arena", "mapping")


def test_file_is_the_same_for_every_run_of_a_profile(tmp_path: Path) -> None:
    expected = tmp_path / "state" / "sim" / "arena" / "mapping.checkpoint"
    assert checkpoint_file(tmp_path, "sim/arena", "mapping") == expected


def test_written_checkpoint_is_read_back(path: Path) -> None:
    write_file(path, encode([1]))
    write_file(path, encode([2]))
    found = read_file(path)
    assert found is not None
    assert found.state == [2]
    assert list(path.parent.iterdir()) == [path]


def test_missing_file_means_no_checkpoint(path: Path) -> None:
    assert read_file(path) is None
    assert set_aside(path, "damaged") is None


@pytest.mark.parametrize(
    "content", [b"", b"x", b"ROBBIECP", encode([1])[:-1], encode([1]).replace(b"[1]", b"[2]")]
)
def test_damaged_file_is_reported_as_damaged(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    with pytest.raises(CheckpointDamaged):
        read_file(path)


def test_file_of_a_newer_version_is_reported_as_newer(path: Path) -> None:
    write_file(path, encode([1])[:8] + b"\2" + encode([1])[9:])
    with pytest.raises(CheckpointTooNew):
        read_file(path)


def test_folder_in_place_of_the_file_is_an_error_with_its_path(path: Path) -> None:
    path.mkdir(parents=True)
    with pytest.raises(CheckpointFileError, match=r"mapping\.checkpoint cannot be read"):
        read_file(path)


def test_full_disk_keeps_the_old_file_and_leaves_no_temporary_file(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_file(path, encode([1]))

    def refuse(_fd: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(os, "fsync", refuse)
        with pytest.raises(OSError, match="No space"):
            write_file(path, encode([2]))
    found = read_file(path)
    assert found is not None
    assert found.state == [1]
    assert list(path.parent.iterdir()) == [path]


def test_content_and_every_new_folder_are_synced(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    fsync = os.fsync

    def note(fd: int) -> None:
        synced.append(Path(os.readlink(f"/proc/self/fd/{fd}")).name)
        fsync(fd)

    monkeypatch.setattr(os, "fsync", note)
    write_file(path, encode([1]))
    unfinished = f".mapping.checkpoint.{os.getpid()}.new"
    assert synced == [path.parents[3].name, "state", "sim", unfinished, "arena"]
    synced.clear()
    write_file(path, encode([2]))
    assert synced == [unfinished, "arena"]


def test_file_set_aside_replaces_the_one_set_aside_before(path: Path) -> None:
    for number in (1, 2):
        write_file(path, encode([number]))
        aside = set_aside(path, "damaged")
        assert aside is not None
        assert aside.name == "mapping.checkpoint.damaged"
        found = read_file(aside)
        assert found is not None
        assert found.state == [number]
    assert list(path.parent.iterdir()) == [aside]
