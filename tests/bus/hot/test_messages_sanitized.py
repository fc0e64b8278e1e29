"""The codec in C stays within its memory and does only what C defines, for any bytes."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.bus.hot._support.under_asan import environment

PROGRAM = "tests.bus.hot._support.messages_under_asan"
TESTS = ("test_native_codec", "test_loans")


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_sanitizers_find_nothing_in_the_codec(compiler_command: list[str], kept_builds: Path) -> None:
    """Neither in the fuzzer's inputs nor in the tests of messages."""
    done = subprocess.run(
        [sys.executable, "-m", PROGRAM, str(kept_builds), "1", "300", *TESTS],
        env=environment(compiler_command), capture_output=True, text=True, check=False, timeout=1100,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-5000:]}"
    assert "nothing to report" in done.stdout and " passed" in done.stdout
