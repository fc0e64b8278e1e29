"""The judge of the link campaign notices what is tampered with, and a short campaign violates nothing."""

from pathlib import Path

import pytest

from tools.link.campaign import Campaign, Epoch, judge, judge_closed, since

SENT = {"reliable": [1, 2, 3, 4, 5]}
BOOKS = {"reliable": (5, 4, 1)}


def test_the_judge_accepts_journals_that_agree_with_the_counts() -> None:
    assert judge(SENT, {"reliable": [1, 2, 4, 5]}, BOOKS, {}, 0) == []


def test_the_judge_notices_each_violation() -> None:
    for received, problem in (
        ([1, 2, 2, 4, 5], "duplicates"),
        ([1, 4, 2, 5], "not in order"),
        ([1, 2, 4, 6], "never sent"),
        ([1, 2, 5], "in the counts"),
    ):
        assert any(problem in one for one in judge(SENT, {"reliable": received}, BOOKS, {}, 0)), problem
    assert any(
        "accounted for" in one for one in judge(SENT, {"reliable": [1]}, {"reliable": (5, 1, 1)}, {}, 9)
    )
    lost = judge(SENT, {"reliable": [1, 2, 3]}, {"reliable": (3, 3, 0)}, {}, 0)
    assert any("counted" in one for one in lost)
    assert not judge(SENT, {"reliable": [1, 2, 3]}, {"reliable": (3, 3, 0)}, {"reliable": 2}, 0)


def test_what_a_killed_receiver_took_with_it_is_excused() -> None:
    received = {"reliable": [1, 2]}
    assert judge(SENT, received, BOOKS, {}, 0)
    assert judge(SENT, received, BOOKS, {}, 0, excused=2) == []


def test_a_killed_senders_messages_are_judged_by_the_books_that_it_last_told() -> None:
    sent = {"reliable": list(range(1, 101))}
    received = {"reliable": [*range(1, 81), *range(96, 101)]}  # 15 are missing
    # 90 were counted: 80 received, 4 lost, 6 under way; 5 were sent since then.
    assert judge_closed(sent, received, Epoch(1, 95, {"reliable": (90, 80, 4)}, 0, 0)) == []
    (problem,) = judge_closed(sent, received, Epoch(1, 95, {"reliable": (95, 91, 4)}, 0, 0))
    assert "15 missing, but 4 counted" in problem
    assert judge_closed(sent, received, Epoch(1, 95, {"reliable": (95, 91, 4)}, 6, 0)) == []
    assert since(received, 96) == {"reliable": [96, 97, 98, 99, 100]}


@pytest.mark.every_turn
def test_a_short_campaign_violates_nothing(tmp_path: Path) -> None:
    report = Campaign(tmp_path, seed=3).play(kills=8)
    assert report.violations == []
    assert report.links_killed == 8
    assert report.received["reliable"] > 100
