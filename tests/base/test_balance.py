"""What a reader has read is what it used and what it left out, by reason."""

import pytest

from robbie_mp.base.balance import MAX_REASONS, OTHER_REASONS, Balance, LeftOut


def test_read_is_used_and_left_out() -> None:
    balance = Balance()
    balance.use(3)
    balance.leave_out("too long", 2)
    balance.leave_out("too long")
    balance.leave_out("none of these", 0)
    assert (balance.read, balance.left_out) == (6, {"too long": 3})
    assert balance.lines("lines") == ["read 6 lines: 3 used, 3 left out", "left out 3: too long"]


def test_strict_balance_refuses_the_first_loss() -> None:
    balance = Balance(is_strict=True)
    balance.leave_out("none of these", 0)
    with pytest.raises(LeftOut, match="2 left out: too long"):
        balance.leave_out("too long", 2)


def test_reasons_of_a_foreign_file_are_bounded() -> None:
    balance = Balance()
    for number in range(2 * MAX_REASONS):
        balance.leave_out(f"topic {number}")
    assert len(balance.left_out) == MAX_REASONS + 1
    assert balance.left_out[OTHER_REASONS] == MAX_REASONS and balance.read == 2 * MAX_REASONS
