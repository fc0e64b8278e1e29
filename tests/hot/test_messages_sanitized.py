"""Whatever bytes the codec in C gets: it stays within its memory and does what C defines."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.hot._support.under_asan import environment

PROGRAM = "tests.hot._support.messages_under_asan"
TESTS = ("test_native_codec", "test_damaged_bytes", "test_views", "test_loans", "test_encoding")


def run(command: list[str], folder: Path, *arguments: str) -> str:
    """Run the program with the sanitizers; return what it says."""
    done = subprocess.run(
        [sys.executable, "-m", PROGRAM, str(folder), *arguments],
        env=environment(command),
        capture_output=True,
        text=True,
        check=False,
        timeout=590,
    )
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-5000:]}"
    return done.stdout


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_sanitizers_find_nothing_in_the_codec(compiler_command: list[str], kept_builds: Path) -> None:
    assert "nothing to report" in run(compiler_command, kept_builds, "1", "2000")


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_sanitizers_find_nothing_in_the_tests_of_messages(
    compiler_command: list[str], kept_builds: Path
) -> None:
    said = run(compiler_command, kept_builds, "2", "50000", *TESTS)
    assert "nothing to report" in said and " passed" in said
