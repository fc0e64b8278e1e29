"""Files that are written never follow what others have put at their place."""

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from robbie_mp.base.linux.private_files import (
    UNFINISHED,
    make_private_file,
    make_private_folder,
    private_opener,
    replacing,
    write_private,
)
from robbie_mp.logs.recording.appended_file import AppendedFile
from robbie_mp.run.trace.rotating_file import RotatingFile


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    """A file outside the folder for results, to which links lead."""
    path = tmp_path / "victim"
    path.write_text("precious")
    return path


@pytest.fixture
def results(tmp_path: Path) -> Path:
    folder = tmp_path / "results"
    folder.mkdir()
    return folder


@pytest.mark.parametrize(
    "name", ["map.png", pytest.param(f".map.png.{os.getpid()}{UNFINISHED}", id="unfinished")]
)
def test_planted_link_is_replaced_and_not_followed(results: Path, victim: Path, name: str) -> None:
    (results / name).symlink_to(victim)
    write_private(results / "map.png", b"map")
    assert victim.read_text() == "precious"
    assert (results / "map.png").read_bytes() == b"map"
    assert not (results / "map.png").is_symlink()
    assert [path.name for path in results.iterdir()] == ["map.png"]


def test_planted_file_does_not_keep_its_mode_or_its_readers(results: Path) -> None:
    path = results / "map.png"
    path.touch(mode=0o644)
    with path.open() as reader:
        write_private(path, "secret", durably=True)
        assert reader.read() == ""
    assert path.stat().st_mode & 0o777 == 0o600


def test_file_that_cannot_be_finished_leaves_the_old_one_and_nothing_else(results: Path) -> None:
    (results / "map.png" / "full").mkdir(parents=True)
    with pytest.raises(IsADirectoryError):
        write_private(results / "map.png", b"map")
    assert [path.name for path in results.iterdir()] == ["map.png"]


def test_appending_to_a_planted_link_is_refused(results: Path, victim: Path) -> None:
    (results / "laser.jsonl").symlink_to(victim)
    with pytest.raises(OSError, match="symbolic link"):
        RotatingFile(results / "laser.jsonl", 1000, 2).write(b"line\n")
    assert victim.read_text() == "precious"


def appends(path: Path) -> None:
    with open(path, "ab", opener=private_opener):
        pass


def rotates(path: Path) -> None:
    file = RotatingFile(path, 1000, 3)
    file.begin_anew()
    file.write(b"line")


@pytest.mark.parametrize(
    "write",
    [
        lambda path: write_private(path, b"x"),
        make_private_file,
        appends,
        rotates,
        AppendedFile,
        lambda path: make_private_folder(path.parent),
    ],
    ids=["replace", "make", "append", "rotate", "record", "folder"],
)
def test_planted_link_to_a_folder_is_not_followed(
    results: Path, tmp_path: Path, write: Callable[[Path], object]
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "map.png").write_text("precious")
    (results / "images").symlink_to(elsewhere)
    with pytest.raises(OSError, match=r"refused|links to folders are not followed"):
        write(results / "images" / "map.png")
    assert [path.name for path in elsewhere.iterdir()] == ["map.png"]
    assert (elsewhere / "map.png").read_text() == "precious"


def test_next_writer_removes_what_killed_writers_have_left_and_no_more(results: Path) -> None:
    """Whatever their pids: those of other containers mean nothing here."""
    left = [f".map.png.{pid}{UNFINISHED}" for pid in (1, os.getpid(), 2**22 + 1)]
    others = ["map.png", ".map.png.mine.new", f"map.png.7{UNFINISHED}", f".being-written.8{UNFINISHED}"]
    for name in [*left, *others]:
        (results / name).touch()
    with (results / others[-1]).open() as written:
        fcntl.flock(written, fcntl.LOCK_EX)
        write_private(results / "mapping.json", "{}")
        assert {path.name for path in results.iterdir()} == {*others, "mapping.json"}


def test_file_that_is_being_written_is_not_removed_by_other_processes(results: Path) -> None:
    program = (
        "import sys; from pathlib import Path; from robbie_mp.base.linux.private_files import write_private;"
        "write_private(Path(sys.argv[1]), 'other')"
    )
    with replacing(results / "map.png") as file:
        subprocess.run([sys.executable, "-c", program, str(results / "mapping.json")], check=True)
        file.write(b"map")
    assert (results / "map.png").read_bytes() == b"map"
    assert {path.name for path in results.iterdir()} == {"map.png", "mapping.json"}
