"""Plays simulated runs over the hot path in C, built with AddressSanitizer and UndefinedBehaviorSanitizer.

    python -m tests.bus.hot._support.under_asan FOLDER FIRST COUNT

The interpreter must have the sanitizer's library preloaded; `environment` says how. It plays histories,
robots drawn at random, and hostile modules made up by `tools.fuzz.core`, and ends with the sanitizer's report
if there is one.
"""

import contextlib
import os
import subprocess
import sys
from itertools import islice
from pathlib import Path

from tests.bus.core._support.simulated_run import SimulatedRun
from tests.bus.hot._support.build import fused_module
from tests.bus.hot._support.histories import crowd, history
from tests.bus.hot._support.memory import FusedMemory
from tools.fuzz.core.attack import CoreFinding, SimulatedAttack
from tools.fuzz.core.plain import inputs

SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-fno-omit-frame-pointer")


def environment(compiler: list[str]) -> dict[str, str]:
    """Return the environment of an interpreter that may load what SANITIZERS has built."""
    libraries = [
        subprocess.run(
            [*compiler, f"-print-file-name={name}"], capture_output=True, text=True, check=True
        ).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    return os.environ | {
        "LD_PRELOAD": " ".join(libraries),
        "PYTHONMALLOC": "malloc",  # Python's own allocator would hide who writes where he must not
        "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=0:allocator_may_return_null=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }


def main() -> None:
    """Play them, each by its number."""
    folder, first, count = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    SimulatedRun.memory = FusedMemory(fused_module(folder, *SANITIZERS), with_c=True)
    for number in range(first, first + count):
        history(number)
        crowd(number)
    attacks = 0
    for data in islice(inputs(seed=first), 5 * count):
        with contextlib.suppress(CoreFinding):  # others judge what the core says of it
            SimulatedAttack(data).run()
        attacks += 1
    print(f"{count} histories, {count} robots, {attacks} hostile modules, nothing to report")


if __name__ == "__main__":
    main()
