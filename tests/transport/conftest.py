"""What tests of messages in memory share."""

from collections.abc import Iterator

import pytest

from tests.transport._support.pair import Pair


@pytest.fixture
def pair() -> Iterator[Pair]:
    made = Pair()
    yield made
    made.close()
