"""A file contains the appended data, in any pieces; a failed append leaves no trace."""

import os
import resource
import signal
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.logs.recording.appended_file import BLOCK_BYTES, PIECE_BYTES, AppendedFile

SIZES = st.one_of(
    st.integers(0, 3 * BLOCK_BYTES),
    st.sampled_from([BLOCK_BYTES, PIECE_BYTES, PIECE_BYTES - 1, PIECE_BYTES + 1, 2 * PIECE_BYTES + 17]),
)


def content(size: int, seed: int) -> bytes:
    return bytes((index * 7 + seed) % 251 for index in range(size % 1000)) + bytes([seed % 256]) * (
        size - size % 1000
    )


@settings(max_examples=40, deadline=None)
@given(st.lists(st.lists(SIZES, max_size=4), max_size=8))
def test_file_contains_the_appended_data(appends: list[list[int]]) -> None:
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:  # on a disk: /tmp may be in memory
        path, expected, seed = Path(folder) / "file", b"", 0
        file = AppendedFile(path)
        for sizes in appends:
            pieces = [content(size, seed := seed + 1) for size in sizes]
            file.append(pieces)
            expected += b"".join(pieces)
            assert file.bytes == path.stat().st_size == len(expected)
            assert path.read_bytes() == expected  # also for who reads while it is written
        file.close()
        assert path.read_bytes() == expected


@pytest.mark.parametrize("room", [1, BLOCK_BYTES - 1, BLOCK_BYTES, PIECE_BYTES, PIECE_BYTES + 4097])
def test_append_that_does_not_fit_is_undone_and_a_smaller_one_succeeds(tmp_path: Path, room: int) -> None:
    path = tmp_path / "file"
    file = AppendedFile(path)
    first = content(5000, 1)
    file.append([first])
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(first) + room, hard))
    try:
        with pytest.raises(OSError, match="too large"):
            file.append([content(2 * PIECE_BYTES, 2)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert file.bytes == path.stat().st_size == len(first)
    second = content(PIECE_BYTES + 123, 3)
    file.append([second])
    file.close()
    assert path.read_bytes() == first + second


def test_page_cache_is_used_without_direct_writes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ordinary = os.open

    def refuse(path: Path, flags: int, mode: int = 0o777, *, dir_fd: int | None = None) -> int:
        if flags & os.O_DIRECT:
            raise OSError(22, "Invalid argument")
        return ordinary(path, flags, mode, dir_fd=dir_fd)

    monkeypatch.setattr(os, "open", refuse)
    file = AppendedFile(tmp_path / "file")
    file.append([content(PIECE_BYTES + 5, 1)])
    file.close()
    assert (tmp_path / "file").read_bytes() == content(PIECE_BYTES + 5, 1)
