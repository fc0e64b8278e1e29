"""Slamtec RPLidar laser range finders."""
