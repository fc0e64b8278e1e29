"""What stands between processes: segments, rings, semaphores, loans and views."""
