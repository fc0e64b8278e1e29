"""Memory and signals between processes: segments, rings, semaphores, loans and views."""
