"""The core and the modules' ends in C, with their bindings, under Address- and UndefinedBehaviorSanitizer.

Histories, robots whose core dies, and hostile modules are played in an interpreter of its own; by hand more:

    python -m tests.bus.hot._support.under_asan FOLDER FIRST COUNT
"""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.bus.hot._support.under_asan import environment

HISTORIES = 20


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_sanitizers_find_nothing_in_the_core(compiler_command: list[str], kept_builds: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.bus.hot._support.under_asan", kept_builds, "0", str(HISTORIES)],
        env=environment(compiler_command), capture_output=True, text=True, check=False, timeout=590,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert "nothing to report" in done.stdout
