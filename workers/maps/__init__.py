"""Maps for other workers: navigation grids, files, pictures."""
