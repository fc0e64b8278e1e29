"""Compares the codec in C, built with AddressSanitizer and UndefinedBehaviorSanitizer, with Python.

    python -m tests.bus.hot._support.messages_under_asan FOLDER SEED COUNT [TESTS]

The interpreter must have the sanitizer's library preloaded; see `under_asan`. It runs the fuzzer, then the
named tests of messages, such as `test_views`, and ends with the sanitizer's report if there is one.
"""

import sys
from pathlib import Path

from tests.bus.hot._support.tests_under_asan import run_tests, use_sanitizers

MESSAGES = Path(__file__).parents[3] / "messages"


def main() -> None:
    """Let the message classes use that build, and run everything."""
    folder, seed, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    use_sanitizers(folder)
    from tests.messages._support.codec_fuzz import fuzz  # noqa: PLC0415 (uses the build that was loaded)

    print(f"{count} inputs, {fuzz(seed, count)} of them messages, nothing to report")
    if tests := [str(MESSAGES / f"{name}.py") for name in sys.argv[4:]]:
        # Under the sanitizer's allocator, errors worded in Python seem to leak, also without C.
        run_tests("-k", "not leaks", *tests)


if __name__ == "__main__":
    main()
