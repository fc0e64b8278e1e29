"""The bindings of the hot path in C, as modules use them, under Address- and UndefinedBehaviorSanitizer.

All tests of transport, messages and the hot path pass with such a build; this runs some of them.
"""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.bus.hot._support.under_asan import environment

PROGRAM = "tests.bus.hot._support.tests_under_asan"
TRANSPORT = Path(__file__).parents[1] / "transport"
TESTS = ("test_messages_in_memory", "test_endpoint", "test_ring")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_sanitizers_find_nothing_in_the_bindings(compiler_command: list[str], kept_builds: Path) -> None:
    tests = [str(TRANSPORT / f"{name}.py") for name in TESTS]
    done = subprocess.run(
        [sys.executable, "-m", PROGRAM, str(kept_builds), "-k", "not python", *tests],
        env=environment(compiler_command), capture_output=True, text=True, check=False, timeout=590,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-5000:]}"
    assert " passed" in done.stdout
