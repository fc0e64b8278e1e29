"""Lets a process see only the runs of its own test session: not the user's, nor those of another session."""

from typing import Any

from robbie_mp.run import run_directory

EVERY_BASE_FOLDER = run_directory.base_folders


def own_base_folders() -> Any:
    """Return the folder for runs without /tmp/robbie-UID, which also holds the user's own robots."""
    return EVERY_BASE_FOLDER()[:1]


def see_own_runs_only() -> None:
    """Let this process, which a test started, list and sweep only the session's runs."""
    run_directory.base_folders = own_base_folders
