"""A fuzzer that attacks the core as a hostile module; see `tools.fuzz.core.__main__`."""
