"""Compares the codec in C, built with AddressSanitizer and UndefinedBehaviorSanitizer, with Python.

    python -m tests.hot._support.messages_under_asan FOLDER SEED COUNT [TESTS]

The interpreter must have the sanitizer's library preloaded; see `under_asan`. It runs the fuzzer, then the
named tests of messages, such as `test_views`, and ends with the sanitizer's report if there is one.
"""

import sys
from pathlib import Path

import pytest

from robbie_mp import _hot
from tests.hot._support.build import fused_module
from tests.hot._support.under_asan import SANITIZERS

MESSAGES = Path(__file__).parents[2] / "messages"


def main() -> None:
    """Let the message classes use that build, and run everything."""
    folder, seed, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    module = fused_module(folder, *SANITIZERS)
    sys.modules["robbie_mp._hot.native"] = module
    _hot.native = module
    from robbie_mp.messages.message import _NATIVE  # noqa: PLC0415 (chosen at import)
    from tests.messages._support.codec_fuzz import fuzz  # noqa: PLC0415

    assert _NATIVE is module
    print(f"{count} inputs, {fuzz(seed, count)} of them messages, nothing to report")
    if tests := [str(MESSAGES / f"{name}.py") for name in sys.argv[4:]]:
        # Under the sanitizer's allocator, errors worded in Python seem to leak, also without C.
        chosen = ["-k", "not leaks", "--assert=plain", "-p", "no:cacheprovider", *tests]
        assert pytest.main(["-q", *chosen]) == pytest.ExitCode.OK


if __name__ == "__main__":
    main()
