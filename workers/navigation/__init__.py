"""Plans paths, follows them, and keeps clear of obstacles."""
