"""Programs run from a checkout: benchmarks, campaigns, metrics."""
