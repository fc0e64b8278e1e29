"""Fuzz the readers of files and messages.

Valid inputs are damaged and read, in a process whose memory is limited. A reader reads an input or refuses it
with an error of its own; any other error, a hang, or a death of the process is a failure.

    python -m tools.fuzz.readers                        every reader, 10 million damaged bytes each
    python -m tools.fuzz.readers --bytes 100000 urdf    one reader, fewer bytes
    python -m tools.fuzz.readers urdf --input 123 --into folder    write an input into a folder
"""

import argparse
import sys
import time
from pathlib import Path

from tools.fuzz.readers.campaign import MEBIBYTE, ReaderResult, damaged_input, run
from tools.fuzz.readers.subjects import subjects

SUBJECTS = f"{subjects.__module__}:{subjects.__name__}"
HEAD = (
    "| reader | damaged bytes | inputs | read | refused | failures | slowest | memory |\n"
    "|---|---:|---:|---:|---:|---:|---:|---:|"
)


def main() -> int:
    """Fuzz the readers that the command line names; return 1 if one fails."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    known = subjects()
    parser.add_argument("readers", nargs="*", metavar="READER", help=f"of {', '.join(known)}")
    parser.add_argument("--bytes", type=int, default=10_000_000, help="damaged bytes for each reader")
    parser.add_argument("--seed", type=int, default=0, help="random seed")
    parser.add_argument("--input", type=int, help="write this input, instead of reading any")
    parser.add_argument("--into", type=Path, default=Path("input"), help="where to write it")
    options = parser.parse_args()
    if unknown := set(options.readers) - set(known):
        parser.error(f"unknown reader {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    if options.input is not None:
        return _write(options)
    print(HEAD, flush=True)
    failed = False
    for name in options.readers or known:
        began_s = time.monotonic()
        result = run(name, SUBJECTS, options.bytes, options.seed)
        print(_line(name, result), flush=True)
        print(f"{name}: {time.monotonic() - began_s:.0f} s", file=sys.stderr)
        for what, numbers in result.failures.items():
            print(f"    {len(numbers)} times, first in input {numbers[0]}: {what}", flush=True)
        failed |= bool(result.failures)
    return int(failed)


def _line(name: str, result: ReaderResult) -> str:
    failures = sum(map(len, result.failures.values()))
    return (
        f"| {name} | {result.damaged_bytes:,} | {result.inputs:,} | {result.accepted:,} | {result.refused:,} "
        f"| {failures} | {result.slowest_s:.2f} s | {result.peak_bytes / MEBIBYTE:.0f} MiB |"
    )


def _write(options: argparse.Namespace) -> int:
    for name in options.readers:
        reader = subjects()[name]
        files, _ = damaged_input(reader, reader.seeds(), options.seed, options.input)
        for file, data in files.items():
            path = options.into / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
            print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
