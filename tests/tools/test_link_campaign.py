"""The judge of the link campaign notices what is tampered with, and a short campaign violates nothing."""

from pathlib import Path

from tools.link_campaign.campaign import Campaign, judge

SENT = {"reliable": [1, 2, 3, 4, 5]}
BOOKS = {"reliable": (5, 4, 1)}


def test_the_judge_accepts_journals_that_agree_with_the_books() -> None:
    assert judge(SENT, {"reliable": [1, 2, 4, 5]}, BOOKS, {}, 0) == []


def test_the_judge_notices_each_violation() -> None:
    for received, problem in (
        ([1, 2, 2, 4, 5], "duplicates"),
        ([1, 4, 2, 5], "not in order"),
        ([1, 2, 4, 6], "never sent"),
        ([1, 2, 5], "in the books"),
    ):
        assert any(problem in one for one in judge(SENT, {"reliable": received}, BOOKS, {}, 0)), problem
    assert any(
        "accounted for" in one for one in judge(SENT, {"reliable": [1]}, {"reliable": (5, 1, 1)}, {}, 9)
    )
    lost = judge(SENT, {"reliable": [1, 2, 3]}, {"reliable": (3, 3, 0)}, {}, 0)
    assert any("counted" in one for one in lost)
    assert not judge(SENT, {"reliable": [1, 2, 3]}, {"reliable": (3, 3, 0)}, {"reliable": 2}, 0)


def test_a_short_campaign_violates_nothing(tmp_path: Path) -> None:
    report = Campaign(tmp_path, seed=3).play(kills=8)
    assert report.violations == []
    assert report.links_killed == 8
    assert report.received["reliable"] > 100
