"""Another user takes, forges and damages names in shared memory, without effect on a robot."""

import os
import secrets
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from robbie_mp.bus.checkpoint.buffers import CheckpointBuffers
from robbie_mp.bus.checkpoint.image import lay_out
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import ForeignMemory, Segment, SegmentMissing, unlink_segment
from robbie_mp.bus.transport.shared_folder import (
    SHARED_MEMORY,
    NamesTaken,
    make_folder,
    opened_folder,
    remove_names,
)
from robbie_mp.bus.transport.wakeup import Wakeup
from robbie_mp.run.run_directory import RunDirectory
from robbie_mp.run.supervisor.sweep import sweep
from tests._support.implementations import BOTH, Native
from tests._support.robot import Ended, Robot
from tests.security._support.second_user import NOBODY, as_nobody, is_refused, needs_root

RUN = f"attack{os.getpid()}"
FOLDER = SHARED_MEMORY / names.folder(RUN)
NAME = f"{names.folder(RUN)}/data-1-1-0"


@pytest.fixture
def folder() -> Iterator[Path]:
    make_folder(RUN)
    yield FOLDER
    remove_names(RUN)


@pytest.fixture
def foreign() -> Iterator[list[Path]]:
    """What the other user leaves; removed at the end."""
    left: list[Path] = []
    yield left
    for path in left:
        path.rmdir() if path.is_dir() else path.unlink(missing_ok=True)


def segment_of_ours() -> None:
    Segment.create(NAME, 64, SegmentKind.DATA).close()


# -- the folder of a run ---------------------------------------------------------------------------


@needs_root
def test_other_user_can_neither_see_nor_take_nor_change_anything_in_the_folder(folder: Path) -> None:
    segment_of_ours()

    def attack() -> None:
        assert is_refused(lambda: os.listdir(folder))
        assert is_refused((folder / "checkpoint-1-0").touch)
        assert is_refused((SHARED_MEMORY / NAME).read_bytes)
        assert is_refused((SHARED_MEMORY / NAME).unlink)
        assert is_refused(lambda: folder.rename(folder.with_name("robbie-stolen")))

    as_nobody(attack)
    Segment.attach(NAME, SegmentKind.DATA).close()


@needs_root
def test_folder_of_another_user_is_never_opened_written_to_or_swept(foreign: list[Path]) -> None:
    forged = FOLDER / "checkpoint-1-0"
    foreign += [forged, FOLDER / "board", FOLDER]

    def attack() -> None:
        FOLDER.mkdir(mode=0o777)
        FOLDER.chmod(0o777)
        forged.write_bytes(bytes(4096))
        forged.chmod(0o666)
        (FOLDER / "board").touch()

    as_nobody(attack)
    with pytest.raises(ForeignMemory, match=f"belongs to user {NOBODY}"), opened_folder(FOLDER.name):
        pass
    with pytest.raises(ForeignMemory):
        Segment.attach(f"{FOLDER.name}/checkpoint-1-0", SegmentKind.CHECKPOINT, write=True)
    with pytest.raises(ForeignMemory):
        Segment.create(NAME, 64, SegmentKind.DATA)
    with pytest.raises(FileExistsError):
        make_folder(RUN)
    unlink_segment(f"{FOLDER.name}/checkpoint-1-0")
    assert remove_names(RUN) == []
    assert sorted(path.name for path in FOLDER.iterdir()) == ["board", "checkpoint-1-0"]


def test_folder_that_others_can_enter_is_refused(folder: Path) -> None:
    segment_of_ours()
    folder.chmod(0o755)
    with pytest.raises(ForeignMemory, match="has mode 0755, others must have no access"):
        Segment.attach(NAME, SegmentKind.DATA)
    folder.chmod(0o700)


def test_link_in_place_of_a_folder_is_not_followed(folder: Path) -> None:
    segment_of_ours()
    link = SHARED_MEMORY / "robbie-attacklink"
    link.symlink_to(folder)
    try:
        with pytest.raises(ForeignMemory):
            Segment.attach(f"{link.name}/data-1-1-0", SegmentKind.DATA)
    finally:
        link.unlink()


@needs_root
def test_run_whose_folder_name_is_taken_uses_another_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, foreign: list[Path]
) -> None:
    squatted = SHARED_MEMORY / "robbie-0bad0bad"
    foreign.append(squatted)
    as_nobody(squatted.mkdir)
    tokens = iter(["0bad0bad", "0600d1d0"])
    monkeypatch.setattr(secrets, "token_hex", lambda _size: next(tokens))
    run = RunDirectory.create("zoo", tmp_path, tmp_path / "runs")
    assert run.run_id == "0600d1d0"
    run.remove()
    assert squatted.is_dir()


def test_run_reports_that_every_name_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(secrets, "token_hex", lambda _size: "0bad0bad")
    make_folder("0bad0bad")
    try:
        with pytest.raises(NamesTaken, match="0bad0bad"):
            RunDirectory.create("zoo", tmp_path, tmp_path / "runs")
    finally:
        remove_names("0bad0bad")


# -- segments --------------------------------------------------------------------------------------


@needs_root
def test_segment_of_another_user_is_not_attached_even_in_our_folder(folder: Path) -> None:
    segment_of_ours()
    os.chown(SHARED_MEMORY / NAME, NOBODY, NOBODY)
    with pytest.raises(ForeignMemory, match=f"belongs to user {NOBODY}, not to us"):
        Segment.attach(NAME, SegmentKind.DATA)


@pytest.mark.parametrize("mode", [0o604, 0o640, 0o602])
def test_segment_with_access_for_others_is_not_attached(folder: Path, mode: int) -> None:
    segment_of_ours()
    (SHARED_MEMORY / NAME).chmod(mode)
    with pytest.raises(ForeignMemory, match="others must have no access"):
        Segment.attach(NAME, SegmentKind.DATA)


def test_file_that_is_not_regular_is_not_attached(folder: Path) -> None:
    path = SHARED_MEMORY / NAME
    os.mkfifo(path, 0o600)
    with pytest.raises(ForeignMemory, match="no regular file"):
        Segment.attach(NAME, SegmentKind.DATA)
    path.unlink()
    segment_of_ours()
    path.rename(path.with_name("other"))
    path.symlink_to(path.with_name("other"))
    with pytest.raises(ForeignMemory):
        Segment.attach(NAME, SegmentKind.DATA)


@needs_root
def test_forged_checkpoint_is_not_restored(folder: Path) -> None:
    buffers = CheckpointBuffers(RUN, 1, 1, 1 << 20)
    buffers.write(lay_out({"count": 1000}), 1)
    buffers.close()
    (forged,) = folder.glob("checkpoint-1-*")
    os.chown(forged, NOBODY, NOBODY)
    found = CheckpointBuffers(RUN, 1, 2, 1 << 20)
    assert found.found is None
    found.close()


# -- wake-ups --------------------------------------------------------------------------------------


@pytest.mark.parametrize("native", BOTH)
@pytest.mark.usefixtures("folder")
def test_wakeup_to_which_others_have_access_is_refused(native: Native | None) -> None:
    wakeup = Wakeup.create(names.wakeup(RUN, 1, 1))
    (SHARED_MEMORY / names.wakeup(RUN, 1, 1)).chmod(0o666)
    with pytest.raises(ForeignMemory):
        Wakeup.attach(names.wakeup(RUN, 1, 1), native)
    wakeup.close()
    wakeup.unlink()


# -- sweep -----------------------------------------------------------------------------------------


@needs_root
def test_sweep_leaves_names_of_another_user_alone_even_for_root(tmp_path: Path, foreign: list[Path]) -> None:
    dead = "0bad0bad"
    (tmp_path / dead).mkdir(mode=0o700)  # a dead run of ours, with whose id the other user plays
    folder = SHARED_MEMORY / names.folder(dead)
    foreign += [folder / "board", folder]

    def attack() -> None:
        folder.mkdir()
        (folder / "board").touch()

    as_nobody(attack)
    swept = sweep([tmp_path])
    assert dead in swept.runs
    assert not [name for name in swept.names if dead in name]
    assert (folder / "board").exists()


# -- a whole robot ---------------------------------------------------------------------------------

PROFILE = """
modules:
  keeper:
    class: zoo.secrets:Keeper
    settings: {key: "file:keeper.secret"}
    restart: {max_restarts: 1000}
"""


def is_restarted(modules: dict[str, dict[str, Any]], restarts: int) -> bool:
    keeper = modules["keeper"]
    return (keeper["restarts"], keeper["state"]) == (restarts, "RUNNING") and keeper["pid"] != 0


@pytest.mark.slow
@needs_root
def test_module_restarts_although_another_user_takes_every_guessable_name(robot: Robot) -> None:
    source = Path(__file__).parent / "_support" / "secret_modules.py"
    (robot.folder / "zoo" / "secrets.py").write_text(source.read_text())
    robot.write_secret("keeper.secret", "correct-horse-battery-staple")
    robot.write_profile(PROFILE)
    process = robot.start()
    figures = robot.until(partial(is_restarted, restarts=1))
    run_id = robot.known_run().run_id
    sprayed: list[Path] = []

    def attack() -> None:
        os.umask(0)
        for incarnation in range(1, 40):
            for kind in ("out", "in", "wakeup", "data", "checkpoint"):
                (SHARED_MEMORY / f"robbie-{run_id}-{kind}-1-{incarnation}").touch(mode=0o666)
            assert is_refused((SHARED_MEMORY / names.inbound(run_id, 1, incarnation)).touch)

    try:
        as_nobody(attack)
        sprayed += SHARED_MEMORY.glob(f"*robbie-{run_id}-*")
        assert len(sprayed) == 39 * 5
        for restarts in (2, 3):
            os.kill(figures["keeper"]["pid"], signal.SIGKILL)
            figures = robot.until(partial(is_restarted, restarts=restarts))
        Ended.in_order(process)
        assert all(path.exists() for path in sprayed), "what belongs to somebody else was removed"
    finally:
        for path in sprayed:
            path.unlink(missing_ok=True)
    assert not list(SHARED_MEMORY.glob(f"*{run_id}*"))


def test_segment_of_an_ended_run_is_missing_and_not_foreign() -> None:
    with pytest.raises(SegmentMissing, match="its run is over"):
        Segment.attach(NAME, SegmentKind.DATA)


def test_segments_are_private(folder: Path) -> None:
    segment_of_ours()
    assert (SHARED_MEMORY / NAME).stat().st_mode & 0o777 == 0o600
    assert folder.stat().st_mode & 0o777 == 0o700
