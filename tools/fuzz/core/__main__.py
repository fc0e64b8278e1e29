"""Lets a fuzzer act as a hostile module, and checks the core and the other modules.

    python -m tools.fuzz.core [--seconds N] [--seed N] [--plain] [--input FILE]

Run it from a checkout, because the simulated run is that of `tests/bus/core`. An input says what a hostile
module pushes and where it writes in its segment, what it and two innocent modules do in between, and when the
core dies. These are findings: an exception that leaves the core; an input that takes longer than 20 s; an
invalid record whose module is not faulted, or a valid one whose module is faulted; an innocent module that is
faulted; a message that an innocent module did not receive exactly once and in order; counters that do not add
up. The tool keeps the finding's input in the current directory, and `--input` plays it again.

By default, atheris (libFuzzer for Python) makes the inputs. It searches for inputs that reach new branches of
the core, and needs the extra `fuzz`. With `--plain`, the tool makes the inputs in a fixed order: every kind
of record with every word of a dictionary in each of its columns, then random mutations.
"""

import argparse
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tools.fuzz.core import plain
from tools.fuzz.core.corpus import seeds
from tools.fuzz.core.steps import MAX_STEPS, STEP_BYTES

START_AND_END_S = 60.0
FINDING_EXIT = 1
BAD_USAGE = 2


def guided(seconds: int, seed: int) -> int:
    """Fuzz with atheris in a child process. Return 0, or 1 if there was a finding."""
    with tempfile.TemporaryDirectory() as corpus:
        for number, data in enumerate(seeds()):
            Path(corpus, f"seed-{number}").write_bytes(data)
        options = [
            f"-seed={seed}", f"-timeout={plain.HANG_S:.0f}", f"-error_exitcode={FINDING_EXIT}",
            f"-artifact_prefix={os.getcwd()}/", f"-max_total_time={seconds}",
            f"-max_len={MAX_STEPS * STEP_BYTES}", "-len_control=0", "-print_final_stats=1", corpus,
        ]  # fmt: skip
        command = [sys.executable, "-m", "tools.fuzz.core.engine", *options]
        try:
            ended = subprocess.run(
                command, capture_output=True, text=True, timeout=seconds + START_AND_END_S, check=False
            )
        except subprocess.TimeoutExpired:
            print(f"finding: still running {START_AND_END_S:.0f} s after its time", file=sys.stderr)
            return FINDING_EXIT
    output = ended.stdout + ended.stderr
    print(summary(output, ended.returncode))
    if ended.returncode:
        print(output, file=sys.stderr)
    return FINDING_EXIT if ended.returncode else 0


def summary(output: str, returncode: int) -> str:
    """Summarize libFuzzer's output in one line."""

    def last(pattern: str) -> str:
        matches: list[str] = re.findall(pattern, output)
        return matches[-1] if matches else "?"

    return (
        f"{last(r'number_of_executed_units: *([0-9]+)')} executions, "
        f"coverage {last(r'cov: ([0-9]+)')} (features {last(r'ft: ([0-9]+)')}), "
        + (f"finding kept in {last(r'Test unit written to (.*)')}" if returncode else "no finding")
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tool; return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz.core", description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", type=int, default=60, metavar="N")
    parser.add_argument("--seed", type=int, default=1, help="random seed; libFuzzer takes 0 as a random one")
    parser.add_argument(
        "--plain", action="store_true", help="do without atheris, and play inputs in a fixed order"
    )
    parser.add_argument(
        "--input", type=Path, metavar="FILE", help="play the input in this file, such as that of a finding"
    )
    options = parser.parse_args(arguments)
    if options.input:
        if not options.input.is_file():
            print(f"fuzz_core: there is no file {options.input}", file=sys.stderr)
            return BAD_USAGE
        return plain.repeat(options.input)
    if options.plain:
        return plain.search(options.seconds, options.seed, Path.cwd())
    if importlib.util.find_spec("atheris") is None:
        print(
            "fuzz_core: atheris is not installed: pip install 'robbie-mp[fuzz]', or use --plain",
            file=sys.stderr,
        )
        return BAD_USAGE
    return guided(options.seconds, options.seed)


if __name__ == "__main__":
    sys.exit(main())
