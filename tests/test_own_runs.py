"""Tests see the runs of their own session alone, so that their outcome does not rest on what else runs."""

import subprocess
import sys
from pathlib import Path

from robbie_mp.run.live_runs import live_runs
from robbie_mp.run.run_directory import RunDirectory
from tests._support.own_runs import EVERY_BASE_FOLDER
from tests._support.robot import PROJECT, Robot

SWEPT = """\
from tests._support.own_runs import see_own_runs_only
see_own_runs_only()
from robbie_mp.run import run_directory
from robbie_mp.run.supervisor import sweep
own = run_directory.secrets.token_hex(4)
another = f"{int(own[:4], 16) ^ 1:04x}{own[4:]}"
print(*[bool(sweep.SHARED_NAME.fullmatch(f"robbie-{run_id}")) for run_id in (own, another)])
"""


def test_running_robot_of_the_user_is_not_seen(robot: Robot, tmp_path: Path) -> None:
    run = RunDirectory.create("a robot of the user", tmp_path, EVERY_BASE_FOLDER()[-1])
    try:
        assert not run.folder.is_relative_to(tmp_path)
        assert live_runs() == []
        assert run.run_id not in robot.command("list").stdout
    finally:
        run.remove()


def test_runs_of_another_session_are_not_swept() -> None:
    found = subprocess.run(
        [sys.executable, "-c", SWEPT], cwd=PROJECT, capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == ["True", "False"]
