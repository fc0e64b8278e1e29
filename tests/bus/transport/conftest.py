"""What tests of messages in memory share."""

from collections.abc import Iterator

import pytest

from tests._support.implementations import BOTH, Native
from tests.bus.core._support.simulated_run import SimulatedRun
from tests.bus.transport._support.pair import Pair


@pytest.fixture(params=BOTH)
def native(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Native | None:
    """The modules' side of the hot path, in Python and in C, of simulated runs as well."""
    chosen: Native | None = request.param
    monkeypatch.setattr(SimulatedRun, "native_modules", chosen)
    return chosen


@pytest.fixture
def pair(native: Native | None) -> Iterator[Pair]:
    made = Pair(native)
    yield made
    made.close()
