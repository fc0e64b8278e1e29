"""The folder for results: a user's link to it is followed once, at the start, and nobody else's is."""

import os
from pathlib import Path

import pytest

from robbie_mp.run.run_directory import UnsafeRunFolder
from robbie_mp.run.supervisor.run import _results_folder


@pytest.fixture
def disk(tmp_path: Path) -> Path:
    folder = tmp_path / "disk"
    folder.mkdir(mode=0o700)
    return folder


def test_link_of_the_user_is_resolved_at_the_start(tmp_path: Path, disk: Path) -> None:
    (tmp_path / "results").symlink_to(disk)
    assert _results_folder(tmp_path / "results") == disk
    assert _results_folder(tmp_path / "results" / "new") == disk / "new"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make links that belong to others")
def test_link_of_another_user_is_refused(tmp_path: Path, disk: Path) -> None:
    (tmp_path / "results").symlink_to(disk)
    os.lchown(tmp_path / "results", 65534, 65534)
    with pytest.raises(UnsafeRunFolder, match="is a link that belongs to user 65534"):
        _results_folder(tmp_path / "results")
