"""Carries messages between processes: shared memory, the core, checkpoints, and how to observe them."""
