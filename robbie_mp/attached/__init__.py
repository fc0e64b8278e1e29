"""What takes part in a run without being in its profile: tools, their views, the profiler."""
