"""Checkpoints as a module sees them: in a test, and in whole runs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robbie_mp import ModuleHarness
from robbie_mp.bus.checkpoint.errors import UnsupportedState
from robbie_mp.bus.checkpoint.file import read_file, write_file
from robbie_mp.bus.checkpoint.image import encode
from robbie_mp.bus.transport import layout, names
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.bus.transport.words import WORD_BYTES, WORD_MAX
from tests._support.robot import Robot, kill, wait_until
from tests.bus.checkpoint._support import remembering
from tests.bus.checkpoint._support.remembering import Remembering

KEEPER = """
from robbie_mp import Module

class Keeper(Module):
    period_s = 0.01

    def setup(self):
        self.status = f"{self.restored} {self.checkpoint_lost}"

    def tick(self):
        self.checkpoint([1])
"""
PROFILE = """
modules:
  memory:
    class: remembering:Remembering
    ends_run: true
    checkpoint: {{persist: {persist}, persist_every_s: 0.01}}
    restart: {{backoff_s: 0.001}}
"""


def test_harness_shows_the_state_that_a_killed_module_would_restore(tmp_path: Path) -> None:
    with ModuleHarness(Remembering, {"until": 5}, output_directory=tmp_path) as harness:
        assert harness.module.restored is None
        assert harness.checkpoint is None
        harness.advance(0.005)
        state: Any = harness.checkpoint
        assert state["count"] == 3
        assert (state["array"] == 3).all()
    with ModuleHarness(Remembering, output_directory=tmp_path, restored=state) as harness:
        harness.advance(0)
        assert (harness.module.count, harness.module.lives) == (4, 2)
        assert (state["array"] == 3).all(), "the module was given the test's own array"


def test_harness_refuses_states_that_a_robot_refuses(tmp_path: Path) -> None:
    with ModuleHarness(Remembering, output_directory=tmp_path) as harness:
        with pytest.raises(UnsupportedState):
            harness.module.checkpoint({"counts": {1, 2}})
        harness.module.checkpoint({"image": np.zeros((2, 2)).T})
        assert harness.checkpoint["image"].flags.c_contiguous


@pytest.fixture
def robot(robot: Robot) -> Robot:
    """The workspace of whole runs, with the module that remembers."""
    (robot.folder / "remembering.py").write_text(Path(remembering.__file__).read_text())
    return robot


def journal(robot: Robot) -> list[str]:
    return (robot.output / "memory.journal").read_text().splitlines()


def checkpoint_path(robot: Robot) -> Path:
    return robot.folder / "state" / "robot" / "memory.checkpoint"


def test_killed_module_continues_from_its_last_checkpoint(robot: Robot) -> None:
    robot.write_profile(PROFILE.format(persist="false"))
    ended = robot.run("--set", "memory.dies_at=[5, 6, 15]", "--set", "memory.elements=100000")
    assert ended.exit_code == 0, ended.stderr
    assert journal(robot) == [
        "begins at 0, life 1",
        "begins at 4, life 2",
        "begins at 5, life 3",
        "begins at 14, life 4",
        "ends at 20, life 4",
    ]
    assert ended.modules["memory"]["restarts"] == 3
    assert not (robot.folder / "state").exists()


@pytest.mark.slow
def test_next_run_continues_where_the_last_one_ended_unless_it_is_fresh(robot: Robot) -> None:
    robot.write_profile(PROFILE.format(persist="true"))
    for arguments in (["memory.until=5"], ["memory.until=8"]):
        assert robot.run("--set", *arguments).exit_code == 0
    fresh = robot.run("--set", "memory.until=3", "--fresh")
    assert fresh.exit_code == 0
    assert "memory starts fresh; its last checkpoint is kept as" in fresh.stderr
    assert journal(robot) == [
        "begins at 0, life 1",
        "ends at 5, life 1",
        "begins at 5, life 2",
        "ends at 8, life 2",
        "begins at 0, life 1",
        "ends at 3, life 1",
    ]
    found = [read_file(path) for path in (checkpoint_path(robot), Path(f"{checkpoint_path(robot)}.replaced"))]
    assert [one.state["count"] for one in found if one is not None] == [3, 8]


@pytest.mark.slow
@pytest.mark.parametrize("content", [b"garbage", encode([1])[:8] + b"\7" + encode([1])[9:]])
def test_damaged_file_does_not_prevent_the_robot_from_starting(robot: Robot, content: bytes) -> None:
    robot.write_profile(PROFILE.format(persist="true"))
    write_file(checkpoint_path(robot), content)
    ended = robot.run("--set", "memory.until=3")
    assert ended.exit_code == 0, ended.stderr
    assert "starts fresh" in (robot.output / "log" / "memory.jsonl").read_text()
    assert journal(robot) == ["begins at 0, life 1", "ends at 3, life 1"]


def is_written(file: Path) -> bool:
    return file.exists() and any(file.read_bytes())


@pytest.mark.slow
@pytest.mark.parametrize("how", ["removed", "zeroed"])
def test_module_whose_checkpoints_are_all_gone_is_told_that_its_state_is_lost(robot: Robot, how: str) -> None:
    """It began as if the run had just started: a base forgot its emergency stop."""
    (robot.folder / "keeper.py").write_text(KEEPER)
    robot.write_profile("modules:\n  keeper: {class: 'keeper:Keeper', restart: {backoff_s: 0.001}}\n")
    robot.start()
    robot.until(lambda modules: modules["keeper"]["state"] == "RUNNING")
    files = [SHARED_MEMORY / names.checkpoint(robot.known_run().run_id, 1, number) for number in (0, 1)]
    wait_until(lambda: all(map(is_written, files)))
    for restarts, status in ((1, "None True"), (2, "[1] False")):
        for file in files if restarts == 1 else ():
            file.unlink() if how == "removed" else file.write_bytes(bytes(file.stat().st_size))
        kill(robot.top()["keeper"]["pid"])
        robot.until(lambda modules: modules["keeper"]["restarts"] == restarts)  # noqa: B023
        robot.until(lambda modules: modules["keeper"]["status"] == status)  # noqa: B023
        wait_until(lambda: all(map(is_written, files)))
    assert "none is left" in robot.log("keeper")


@pytest.mark.slow
@pytest.mark.every_turn
def test_module_that_wrote_over_its_count_of_checkpoints_goes_on(robot: Robot) -> None:
    """It ended by a ValueError at its next checkpoint."""
    (robot.folder / "keeper.py").write_text(KEEPER)
    robot.write_profile("modules:\n  keeper: {class: 'keeper:Keeper', restart: {backoff_s: 0.001}}\n")
    robot.start()
    robot.until(lambda modules: modules["keeper"]["state"] == "RUNNING")
    own = SHARED_MEMORY / names.outbound(robot.known_run().run_id, 1, 1)
    with own.open("r+b", buffering=0) as words:

        def count(value: int | None = None) -> int:
            words.seek(layout.OUT_CHECKPOINTS * WORD_BYTES)
            if value is not None:
                return words.write(value.to_bytes(WORD_BYTES, "little"))
            return int.from_bytes(words.read(WORD_BYTES), "little")

        wait_until(lambda: count() > 0)
        count(WORD_MAX)
        wait_until(lambda: 0 < count() < WORD_MAX)
    assert robot.top()["keeper"]["restarts"] == 0
    kill(robot.top()["keeper"]["pid"])
    robot.until(lambda modules: modules["keeper"]["status"] == "[1] False")
