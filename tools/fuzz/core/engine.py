"""Fuzzes in this process until libFuzzer ends it: `python -m tools.fuzz.core.engine LIBFUZZER_OPTIONS`."""

import sys
from random import Random

import atheris

# atheris counts only branches of modules that are imported here.
with atheris.instrument_imports(include=["robbie_mp.bus.core", "robbie_mp.bus.transport"]):
    from tools.fuzz.core.attack import SimulatedAttack
    from tools.fuzz.core.corpus import mutate, seeds


def main() -> None:
    """Fuzz until libFuzzer ends the process."""
    known = seeds()

    def change(data: bytes, most_bytes: int, seed: int) -> bytes:
        """Three times out of four, mutate steps; otherwise, let libFuzzer mutate bytes."""
        if seed % 4 == 0:
            changed: bytes = atheris.Mutate(data, most_bytes)
            return changed
        return mutate(data, Random(seed), known)[:most_bytes]

    atheris.Setup(sys.argv, lambda data: SimulatedAttack(data).run(), custom_mutator=change)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
