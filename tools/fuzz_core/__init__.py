"""A fuzzer that attacks the core as a hostile module; see `tools.fuzz_core.__main__`."""
