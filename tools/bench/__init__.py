"""Benchmarks; each is a program: `python -m tools.bench.NAME`."""
