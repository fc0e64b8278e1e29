"""A robot obeys one operator at a time, and another one only after it has taken over."""

import pytest

from robbie_mp.connect.link.operators import FREE_AFTER_NS, LinkOperators
from robbie_mp.messages import OperatorRequest

S = 1_000_000_000


def wish(operators: LinkOperators, operator: str, what: int, now_ns: int = 0) -> None:
    operators.request(operator, OperatorRequest(wish=what), now_ns, now_ns)


def test_first_command_takes_the_command_and_others_are_refused_and_counted() -> None:
    operators = LinkOperators("red")
    assert operators.obeys("anna", 0, 0)
    assert not operators.obeys("ben", 1, 1)
    assert not operators.obeys("ben", 2, 2)
    assert operators.obeys("anna", 3, 3)
    assert (operators.holder, operators.refused, operators.refused_operator) == ("anna", 2, "ben")


def test_only_an_explicit_take_over_moves_the_command() -> None:
    operators = LinkOperators("red")
    operators.obeys("anna", 0, 0)
    wish(operators, "ben", OperatorRequest.TAKE)
    assert operators.holder == "anna"
    wish(operators, "ben", OperatorRequest.TAKE_OVER)
    assert not operators.obeys("anna", 1, 1)
    assert operators.obeys("ben", 1, 1)


def test_stick_that_was_refused_drives_only_after_it_was_let_go() -> None:
    operators = LinkOperators("red")
    operators.obeys("anna", 0, 0)
    for tick in range(20):
        assert not operators.obeys("ben", tick * S // 20, 0)
    wish(operators, "anna", OperatorRequest.GIVE_UP, S)
    for tick in range(20, 40):
        assert not operators.obeys("ben", tick * S // 20, 0)
    assert operators.holder == ""
    assert operators.obeys("ben", 3 * S, 0)


def drives(operators: LinkOperators, operator: str, now_s: float, up_s: float, *, moves: bool = True) -> bool:
    now_ns = round(now_s * S)
    operators.see_drive(operator, round(up_s * S), now_ns, 0, moves=moves)
    return operators.obeys(operator, now_ns, 0)


def test_stick_held_while_the_link_was_down_drives_only_after_it_was_let_go() -> None:
    operators = LinkOperators("red")
    assert drives(operators, "anna", 1.0, 0.5)
    for tick in range(60, 80):
        assert not drives(operators, "anna", tick / 20, 2.9)
    assert operators.holder == ""
    assert drives(operators, "anna", 4.0, 2.9, moves=False)
    assert drives(operators, "anna", 4.1, 2.9)


@pytest.mark.parametrize("says_so", [True, False])
def test_operator_who_let_go_while_the_link_was_down_or_before_drives_at_once(says_so: bool) -> None:
    operators = LinkOperators("red")
    assert drives(operators, "anna", 1.0, 0.5)
    if says_so:
        assert drives(operators, "anna", 1.1, 0.5, moves=False)
    assert drives(operators, "anna", 3.0 if says_so else 3.5, 2.9)


def test_stick_held_while_the_robots_link_was_restarted_drives_only_after_it_was_let_go() -> None:
    before = LinkOperators("red")
    drives(before, "anna", 1.0, 0.5)
    operators = LinkOperators("red", before.as_data())
    assert not drives(operators, "anna", 2.0, 1.9)
    assert not drives(operators, "anna", 2.05, 1.9)
    assert drives(operators, "anna", 3.0, 1.9)


def test_only_its_holder_gives_the_command_up() -> None:
    operators = LinkOperators("red")
    operators.obeys("anna", 0, 0)
    wish(operators, "ben", OperatorRequest.GIVE_UP)
    assert operators.holder == "anna"
    wish(operators, "anna", OperatorRequest.GIVE_UP)
    assert operators.obeys("ben", 1, 1)


def test_command_outlives_a_broken_link_for_some_seconds_only() -> None:
    operators = LinkOperators("red")
    operators.obeys("anna", 0, 0)
    operators.look_after(True, S, S)
    operators.look_after(False, FREE_AFTER_NS, 0)
    assert operators.holder == "anna"
    operators.look_after(False, FREE_AFTER_NS + S, 0)
    assert operators.holder == ""


def test_restarted_link_still_knows_who_holds_the_command() -> None:
    before = LinkOperators("red")
    before.obeys("anna", 0, 5)
    operators = LinkOperators("red", before.as_data())
    assert not operators.obeys("ben", 1, 1)
    operators.look_after(False, 2 * FREE_AFTER_NS, 0)  # the links have not found each other again yet
    assert operators.holder == "anna"


def test_changes_are_told_at_once_and_refusals_once_a_second() -> None:
    operators = LinkOperators("red")
    assert (first := operators.news(S)) is not None
    assert (first.robot, first.operator) == ("red", "")
    assert operators.news(S) is None
    operators.obeys("anna", S, 7)
    assert (taken := operators.news(S)) is not None
    assert (taken.operator, taken.since.nanoseconds) == ("anna", 7)
    told = []
    for tick in range(100, 400):
        operators.obeys("ben", tick * S // 100, 0)
        told += [operators.news(tick * S // 100)]
    states = [one for one in told if one is not None]
    assert len(states) in (2, 3)
    assert states[-1].refused_operator == "ben"
