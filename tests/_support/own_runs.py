"""Lets a process see only the runs of its own test session: not the user's, nor those of another session."""

import os
import re
import secrets
from types import SimpleNamespace
from typing import Any

from robbie_mp.run import run_directory

VARIABLE = "ROBBIE_TEST_SESSION"
"""Marks what the tests of a session start: `PID-TIME` of the session."""
EVERY_BASE_FOLDER = run_directory.base_folders


def own_base_folders() -> Any:
    """Return the folder for runs without /tmp/robbie-UID, which also holds the user's own robots."""
    return EVERY_BASE_FOLDER()[:1]


def see_own_runs_only() -> None:
    """Let this process, which a test started, list and sweep only the session's runs.

    Runs of other sessions have no folder here. So that a sweep does not take them for dead, and what their
    tests killed remains for them to look at, the ids of a session's runs begin with its pid.
    """
    run_directory.base_folders = own_base_folders
    if mark := os.environ.get(VARIABLE):
        from robbie_mp.run.supervisor import sweep  # noqa: PLC0415 (only here, not in the tests' own process)

        begin = f"{int(mark.partition('-')[0]) & 0xFFFF:04x}"
        ids = SimpleNamespace(token_hex=lambda size: begin + secrets.token_hex(size)[len(begin) :])
        vars(run_directory)["secrets"] = ids
        every = run_directory.RUN_ID.pattern
        assert every in sweep.SHARED_NAME.pattern
        sweep.SHARED_NAME = re.compile(sweep.SHARED_NAME.pattern.replace(every, f"{begin}[0-9a-f]{{4}}"))
