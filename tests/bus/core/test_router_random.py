"""Random histories of a small robot: whatever happens, nothing is lost uncounted and nothing leaks."""

from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.bus.core import router
from tests.bus.core._support.history import SLOTS, History

ACTIONS = ["publish"] * 4 + ["handle"] * 3 + ["core"] * 2
ACTIONS += ["kill", "start", "begin_and_die", "keep", "let_go", "make_room", "wait"]
LATCHED_ACTIONS = [*ACTIONS, "kill", "start", "join", "drop_latched"]
STEPS = st.lists(st.tuples(st.sampled_from(ACTIONS), st.sampled_from(SLOTS)), max_size=80)
LATCHED_STEPS = st.lists(st.tuples(st.sampled_from(LATCHED_ACTIONS), st.sampled_from(SLOTS)), max_size=80)
DEATHS = st.lists(st.integers(0, 2000), max_size=3)


@pytest.mark.slow
@pytest.mark.every_turn
@settings(max_examples=200, deadline=None)
@given(STEPS)
def test_any_history_keeps_order_and_books(steps: list[tuple[str, int]]) -> None:
    history = History()
    for action, slot in steps:
        getattr(history, action)(slot)
    history.finish()


@pytest.mark.slow
@settings(max_examples=400, deadline=None)
@given(STEPS, DEATHS, st.booleans(), st.booleans(), st.sampled_from([1, 3, 16]))
def test_any_history_survives_any_deaths_of_the_core(
    steps: list[tuple[str, int]], deaths: list[int], by_patterns: bool, lockstep: bool, at_once: int
) -> None:
    with patch.object(router, "RECORDS_PER_TURN", at_once):  # the rings here are as short as a turn really is
        history = History(tuple(deaths), by_patterns=by_patterns, lockstep=lockstep)
        for action, slot in steps:
            getattr(history, action)(slot)
        history.finish()


@pytest.mark.slow
@pytest.mark.every_turn
@settings(max_examples=100, deadline=None)
@given(LATCHED_STEPS, DEATHS, st.booleans(), st.booleans(), st.sampled_from([4, 1 << 30]))
def test_any_history_of_a_latched_channel_survives_any_deaths_of_the_core(
    steps: list[tuple[str, int]], deaths: list[int], by_patterns: bool, lockstep: bool, latched_bytes: int
) -> None:
    history = History(
        tuple(deaths), by_patterns=by_patterns, lockstep=lockstep, latched=True, latched_bytes=latched_bytes
    )
    for action, slot in steps:
        getattr(history, action)(slot)
    history.finish()
