"""Fuzzes in this process, which libFuzzer ends: `python -m tools.fuzz_core.engine LIBFUZZER_OPTIONS`."""

import sys
from random import Random

import atheris

# Only what is imported in here has its branches counted.
with atheris.instrument_imports(include=["robbie_mp.core", "robbie_mp.transport"]):
    from tools.fuzz_core.attack import Attack
    from tools.fuzz_core.corpus import mutate, seeds


def main() -> None:
    """Fuzz until libFuzzer has enough."""
    known = seeds()

    def change(data: bytes, most_bytes: int, seed: int) -> bytes:
        """Keep the form of steps three times out of four; else let libFuzzer do what it likes."""
        if seed % 4 == 0:
            changed: bytes = atheris.Mutate(data, most_bytes)
            return changed
        return mutate(data, Random(seed), known)[:most_bytes]

    atheris.Setup(sys.argv, lambda data: Attack(data).run(), custom_mutator=change)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
