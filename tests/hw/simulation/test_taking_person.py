"""A simulated person takes hold of what a standing hand holds out near by, and tugs at it now and then."""

import numpy as np
import pytest

from robbie_robots.hw.simulation.taking_person import REACTION_S, TUG_S, TakingPerson

HAND = np.array([1.0, 0.0, 0.6])
STEP_S = 0.1


def forces(person: TakingPerson, people: list[tuple[float, float]], seconds: float) -> list[float]:
    """Return the force along x at each step, in front of a hand that stands."""
    return [float(person.pull(step * STEP_S, HAND, people)[0]) for step in range(round(seconds / STEP_S))]


def test_person_in_reach_tugs_after_a_moment_and_pauses_between_tugs() -> None:
    person = TakingPerson(1.0, 10.0)
    pulled = forces(person, [(1.8, 0.0), (-5.0, 0.0)], REACTION_S + 4 * TUG_S)
    assert max(pulled[: round(REACTION_S / STEP_S) - 1]) == 0.0
    assert max(pulled) == pytest.approx(10.0)
    assert pulled[-1] == 0.0 and person.has_hold
    assert sum(pulled) / 10.0 == pytest.approx(2 * TUG_S / STEP_S, abs=2)


def test_nobody_takes_hold_of_a_hand_that_moves_or_holds_nothing_or_is_far_away() -> None:
    person = TakingPerson(1.0, 10.0)
    for step in range(50):
        moving = HAND + np.array([0.02 * step, 0.0, 0.0])
        assert not person.pull(step * STEP_S, moving, [(float(moving[0]) + 0.5, 0.0)]).any()
        assert not person.has_hold
    assert not any(forces(person, [(2.1, 0.0)], 5.0))
    assert not person.pull(10.0, None, [(1.2, 0.0)]).any()
    assert not person.has_hold
