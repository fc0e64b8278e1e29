"""Files that are written never follow what others have put at their place."""

import os
from pathlib import Path

import pytest

from robbie_mp.base.linux.private_files import UNFINISHED, write_private
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
    assert not RotatingFile(results / "laser.jsonl", 1000, 2).write(b"line\n")
    assert victim.read_text() == "precious"
