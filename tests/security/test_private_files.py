"""Only the robot's user can read its files, and other users cannot replace a checkpoint."""

import os
import signal
import stat
from pathlib import Path

import pytest

from robbie_mp.base.linux.private_files import make_private_folder, write_private
from robbie_mp.bus.checkpoint.errors import CheckpointForeign
from robbie_mp.bus.checkpoint.file import checkpoint_file, read_file, write_file
from robbie_mp.bus.checkpoint.image import encode
from robbie_mp.run.run_directory import base_folders
from tests._support.robot import Ended, Robot
from tests.security._support.second_user import NOBODY, as_nobody, is_refused, needs_root

HERE = Path(__file__).parent
PROFILE = """
modules:
  keeper:
    class: zoo.secrets:Keeper
    checkpoint: {persist: true, persist_every_s: 0.0}
    settings: {key: "file:keeper.secret"}
  logger: {class: "robbie_mp.logs.message_logger:MessageLogger", settings: {folder: logs}}
"""


def open_to_others(*roots: Path) -> list[str]:
    """Files, folders and sockets below these that others have any access to."""
    found = [path for root in roots for path in (root, *root.rglob("*"))]
    return [f"{path}: {stat.filemode(path.stat().st_mode)}" for path in found if path.stat().st_mode & 0o077]


@pytest.mark.slow
def test_everything_that_a_run_writes_is_closed_to_others(robot: Robot) -> None:
    (robot.folder / "zoo" / "secrets.py").write_text((HERE / "_support" / "secret_modules.py").read_text())
    robot.write_secret("keeper.secret", "correct-horse-battery-staple")
    robot.write_profile(PROFILE)
    before = os.umask(0o002)  # as a user has it whose group is trusted
    try:
        process = robot.start(output=robot.folder / "output" / "here")
    finally:
        os.umask(before)
    robot.until(lambda modules: modules["keeper"]["restarts"] == 1 and modules["keeper"]["ticks"] > 3)
    robot.command("param", "set", "keeper.word", "hello")
    run = robot.known_run()
    in_run_folder = open_to_others(run.folder)
    Ended.in_order(process, signal.SIGTERM)
    written = [robot.folder / name for name in ("output", "state", "logs")]
    names = {path.name for root in written for path in root.rglob("*")}
    assert {"summary.json", "trace.html", "keeper.jsonl", "keeper.checkpoint", "crashes"} <= names
    assert any(name.endswith(".mcap") for name in names)
    # Files that a module writes itself have its own modes, but other users cannot enter the folder.
    found = [text for text in open_to_others(*written) if "hash.txt" not in text]
    assert [*in_run_folder, *found] == []


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    path = checkpoint_file(tmp_path, "robot", "keeper")
    write_file(path, encode({"count": 3}))
    return path


def test_checkpoint_on_disk_is_private_with_its_folder(checkpoint: Path) -> None:
    assert checkpoint.stat().st_mode & 0o777 == 0o600
    assert checkpoint.parent.stat().st_mode & 0o777 == 0o700
    found = read_file(checkpoint)
    assert found is not None
    assert found.state == {"count": 3}


@needs_root
def test_checkpoint_of_another_user_is_refused(checkpoint: Path) -> None:
    os.chown(checkpoint, NOBODY, NOBODY)
    with pytest.raises(CheckpointForeign, match=f"belongs to user {NOBODY}, not to us"):
        read_file(checkpoint)


@pytest.mark.parametrize("mode", [0o622, 0o660, 0o606])
def test_checkpoint_that_others_can_write_to_is_refused(checkpoint: Path, mode: int) -> None:
    checkpoint.chmod(mode)
    with pytest.raises(CheckpointForeign, match="others must not be able to write to it"):
        read_file(checkpoint)


def test_checkpoint_of_an_earlier_version_that_others_can_only_read_is_restored(checkpoint: Path) -> None:
    checkpoint.chmod(0o644)
    assert read_file(checkpoint) is not None
    write_file(checkpoint, encode({"count": 4}))
    assert checkpoint.stat().st_mode & 0o777 == 0o600


@pytest.mark.timeout(20)
def test_pipe_in_place_of_a_checkpoint_is_refused_without_blocking(checkpoint: Path) -> None:
    checkpoint.unlink()
    os.mkfifo(checkpoint, 0o600)
    with pytest.raises(CheckpointForeign, match="no regular file"):
        read_file(checkpoint)


def test_link_at_the_path_of_a_checkpoint_is_not_followed(checkpoint: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    checkpoint.with_name(f".{checkpoint.name}.{os.getpid()}.new").symlink_to(victim)
    write_file(checkpoint, encode({"count": 4}))
    assert victim.read_text() == "precious"
    assert not checkpoint.is_symlink()


@pytest.mark.slow
def test_forged_checkpoint_is_set_aside_and_the_module_starts_fresh(robot: Robot) -> None:
    (robot.folder / "zoo" / "secrets.py").write_text((HERE / "_support" / "secret_modules.py").read_text())
    robot.write_secret("keeper.secret", "correct-horse-battery-staple")
    robot.write_profile(PROFILE)
    forged = checkpoint_file(robot.folder, "robot", "keeper")
    write_file(forged, encode(1000))
    forged.chmod(0o666)
    process = robot.start()
    # It counts from the beginning; one that ends before it runs again would not end in order.
    robot.until(lambda modules: modules["keeper"]["restarts"] == 1 and modules["keeper"]["ticks"] > 3)
    Ended.in_order(process, signal.SIGTERM)
    said = robot.log("keeper")
    assert "starts fresh" in said
    assert "others must not be able to write to it" in said
    assert forged.with_name(f"{forged.name}.foreign").exists()


@needs_root
def test_other_user_can_neither_read_nor_enter_private_files_and_folders(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path.parent):
        folder.chmod(0o755)  # pytest closes these itself
    folder = tmp_path / "output" / "run"
    make_private_folder(folder)
    write_private(folder / "plan.json", "{}")
    (folder / "open").touch(mode=0o666)

    def attack() -> None:
        assert is_refused((folder / "plan.json").read_text)
        assert is_refused((folder / "open").read_text)
        assert is_refused((tmp_path / "output" / "squatted").touch)

    as_nobody(attack)


def test_runtime_folder_that_others_can_write_to_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert base_folders()[0] == tmp_path / "robbie"
    tmp_path.chmod(0o777)
    assert tmp_path / "robbie" not in base_folders()
    tmp_path.chmod(0o700)
