"""Programs of a profile that are no modules: their process, what they print, and whether they still work."""
