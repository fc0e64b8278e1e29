"""The other tests of the core are played in Python and in C; here, that they are."""

import pytest

from robbie_mp.bus.core.native_router import NativeRouter
from tests.bus.core._support.simulated_run import SimulatedRun


def test_core_is_in_the_language_that_the_test_names(request: pytest.FixtureRequest) -> None:
    is_in_c = isinstance(SimulatedRun().router, NativeRouter)
    assert is_in_c == (request.node.callspec.params["hot_path"] == "C")
