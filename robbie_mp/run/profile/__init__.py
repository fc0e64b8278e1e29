"""Profiles: YAML files that say which modules run, with which settings."""
