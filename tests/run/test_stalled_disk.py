"""A robot whose disk takes nothing any more goes on, restarts what dies, and ends when it is told to."""

import os
import signal
import time

import pytest

from robbie_mp.trace.reader import last_entries
from tests.run._support.robot import Ended, Robot, wait_until
from tests.run.test_run import ENDLESS
from tools.loop_disk import LoopDisk

pytestmark = pytest.mark.slow

END_LIMIT_S = 15.0


def test_run_on_a_frozen_disk_restarts_its_modules_and_ends_in_order(
    robot: Robot, disk: LoopDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its output is there and the run's own folder, too."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(disk.folder))
    robot.output = disk.folder / "out"
    robot.write_profile(ENDLESS)
    process = robot.start()
    figures = robot.until(lambda modules: all(module["state"] == "RUNNING" for module in modules.values()))
    run_folder = robot.known_run().folder
    disk.freeze()
    os.kill(figures["one"]["pid"], signal.SIGKILL)
    again = robot.until(
        lambda modules: modules["one"]["state"] == "RUNNING" and modules["one"]["restarts"] == 1
    )
    assert again["one"]["pid"] != figures["one"]["pid"]
    begin_s = time.monotonic()
    process.send_signal(signal.SIGINT)
    ended = Ended.wait_for(process)
    assert time.monotonic() - begin_s < END_LIMIT_S
    assert ended.exit_code == 0
    assert f"the disk of {robot.output} has stalled" in ended.stderr
    assert not (robot.output / "summary.json").exists()
    assert run_folder.exists()
    disk.thaw()  # and what was handed over is written, and removed, after all
    wait_until(lambda: not run_folder.exists())
    assert (robot.output / "summary.json").exists()
    assert any("crashed" in entry.text for entry in last_entries(robot.output, "one", 100))
