"""The ways that pages propose, as the map shows them."""

from dataclasses import replace
from time import monotonic

import pytest

pytest.importorskip("nicegui")

from robbie_mp.station.floor.sight import Spot
from robbie_mp.station.floor.touch_to_go import Proposal, Proposals


def test_way_that_is_planned_again_is_drawn_again() -> None:
    proposals = Proposals({"page"})
    spot = Spot(2.0, 0.0, (2.0, 0.0, 0.0), (0.0, 0.0), 2.0)
    first = Proposal(1, spot, [[0.0, 0.0], [2.0, 0.0]], monotonic())
    proposals.put("page", first)
    before = proposals.cells()
    proposals.put("page", replace(first, way=[[1.0, 0.0], [2.0, 0.0]]))
    after = proposals.cells()
    assert after.revision != before.revision
    assert after.middles[0].tolist() == [1.0, 0.0]
