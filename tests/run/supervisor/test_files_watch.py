"""Removed and truncated files are noticed; those that grow or end in order are not."""

from itertools import count
from pathlib import Path

import pytest

from robbie_mp.run.supervisor.files_watch import CHECK_PERIOD_S, Damage, Files, FilesWatch

OWNER = ("laser", 3)


class Watched:
    """A watch over files in a folder, with a clock that always says that it is time."""

    def __init__(self, folder: Path):
        self.now_s = 0.0
        self.core, self.data = folder / "core", folder / "data"
        for path in (self.core, self.data):
            path.write_bytes(bytes(100))
        self.passing: Files = {str(self.data): OWNER}
        self.watch = FilesWatch(lambda: {str(self.core): None}, lambda: self.passing, lambda: self.now_s)

    def look(self) -> list[Damage]:
        self.now_s += CHECK_PERIOD_S
        return self.watch.look()


@pytest.fixture
def watched(tmp_path: Path) -> Watched:
    return Watched(tmp_path)


def test_truncated_files_are_damage_of_their_owners(watched: Watched) -> None:
    watched.core.write_bytes(bytes(99))
    watched.data.write_bytes(b"")
    expected = {Damage(str(watched.core), "truncated", None), Damage(str(watched.data), "truncated", OWNER)}
    assert set(watched.look()) == expected
    assert watched.watch.look() == []  # it is not yet time
    assert set(watched.look()) == expected


def test_needed_file_that_was_truncated_before_the_first_look_is_damage(tmp_path: Path) -> None:
    """A module may do that to its memory as soon as it starts: it went on without it."""
    path = tmp_path / "in-4-2"
    path.write_bytes(b"")
    now_s = count(0.0, CHECK_PERIOD_S)
    watch = FilesWatch(lambda: {str(path): OWNER}, dict, now_s.__next__)
    assert watch.look() == [Damage(str(path), "truncated", OWNER)]


def test_grown_or_removed_data_is_no_damage(watched: Watched) -> None:
    watched.data.write_bytes(bytes(200))
    assert watched.look() == []
    watched.data.unlink()
    assert watched.look() == []
    watched.passing = {}
    assert watched.look() == []
    watched.data.write_bytes(bytes(10))  # of that name, a new one
    watched.passing = {str(watched.data): OWNER}
    assert watched.look() == []


def test_file_that_everybody_needs_is_missed(watched: Watched) -> None:
    watched.core.unlink()
    assert watched.look() == [Damage(str(watched.core), "removed", None)]
