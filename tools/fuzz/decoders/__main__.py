"""Fuzz the decoders of device protocols.

A decoder must raise nothing, and lose at most two intact frames after any damage.

    python -m tools.fuzz.decoders                        every decoder, 10 million damaged bytes each
    python -m tools.fuzz.decoders --bytes 100000 mip     one decoder, fewer bytes
"""

import argparse
import sys
import time

from tools.fuzz.decoders.fuzz import fuzz
from tools.fuzz.decoders.subjects import SUBJECTS


def main() -> int:
    """Fuzz the decoders that the command line names; return 1 if one fails."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("decoders", nargs="*", metavar="DECODER", help=f"of {', '.join(SUBJECTS)}")
    parser.add_argument("--bytes", type=int, default=10_000_000, help="damaged bytes for each decoder")
    parser.add_argument("--seed", type=int, default=0, help="random seed")
    options = parser.parse_args()
    if unknown := set(options.decoders) - set(SUBJECTS):
        parser.error(f"unknown decoder {', '.join(sorted(unknown))}; there are {', '.join(SUBJECTS)}")
    failed = False
    for name in options.decoders or SUBJECTS:
        began_s = time.monotonic()
        outcome = fuzz(SUBJECTS[name], options.bytes, options.seed)
        print(
            f"{name:12} {outcome.damaged_bytes:>12,} damaged bytes in {outcome.rounds:>9,} rounds: "
            f"at most {outcome.most_lost} intact frames lost, {len(outcome.failures)} failures, "
            f"{time.monotonic() - began_s:.0f} s",
            flush=True,
        )
        for failure in outcome.failures:
            print(f"    {failure}")
        failed |= bool(outcome.failures)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
