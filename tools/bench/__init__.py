"""Benchmarks: Robbie beside its peers and two floors; `python -m tools.bench --help`."""
