"""Whole runs for tests of the trace."""

from tests.run.conftest import robot

__all__ = ["robot"]
