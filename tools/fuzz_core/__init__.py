"""A hostile module in front of the core, made up by a fuzzer; see `tools.fuzz_core.__main__`."""
