"""Runs tests over the hot path in C, built with AddressSanitizer and UndefinedBehaviorSanitizer.

    python -m tests.bus.hot._support.tests_under_asan FOLDER PYTEST_ARGUMENT...

The interpreter must have the sanitizer's library preloaded; see `under_asan`. Processes that a test starts
use the installed build. The run ends with the sanitizer's report if there is one.
"""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from robbie_mp.bus import _hot
from tests.bus.hot._support.build import fused_module
from tests.bus.hot._support.under_asan import SANITIZERS


def use_sanitizers(folder: Path) -> ModuleType:
    """Let everything use a build with sanitizers, kept in a folder; before message classes are imported."""
    module = fused_module(folder, *SANITIZERS)
    sys.modules["robbie_mp.bus._hot.native"] = module
    _hot.native = module
    from robbie_mp.messages.message import _NATIVE  # noqa: PLC0415 (chosen at import)

    assert _NATIVE is module
    return module


def run_tests(*arguments: str) -> None:
    """Run tests in this process.

    Raises:
        AssertionError: one fails.
    """
    # The sanitizer's report goes to the descriptor, which pytest must not catch: the process ends with it.
    chosen = ["-q", "--assert=plain", "--capture=sys", "-p", "no:cacheprovider", *arguments]
    assert pytest.main(chosen) == pytest.ExitCode.OK


if __name__ == "__main__":
    use_sanitizers(Path(sys.argv[1]))
    run_tests(*sys.argv[2:])
