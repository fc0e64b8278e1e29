"""Hokuyo laser range finders."""
