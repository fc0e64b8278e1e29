from tests.run.conftest import robot

__all__ = ["robot"]
