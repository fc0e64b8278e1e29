"""Fuzzers: hostile modules for the core, and damaged bytes for decoders of devices."""
