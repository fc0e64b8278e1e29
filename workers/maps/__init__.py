"""Maps as other workers use them: grids to plan on, files, pictures."""
