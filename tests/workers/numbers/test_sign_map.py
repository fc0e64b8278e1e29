"""Signs are read by several views that agree, others are refused, and posts are looked at from all sides."""

import math

import numpy as np
import pytest

from workers.numbers.sign_map import ALL_SECTORS, SECTORS, SheetVotes, SignMap, sector, sector_rad

POST = np.array([3.0, 1.0])


def seen(signs: SignMap, text: str, times: int, *, beside_m: float = 0.0) -> None:
    for _ in range(times):
        signs.see(text, POST + np.array([0.0, beside_m]), math.pi, 2.0, 60.0)


def test_digit_is_sure_after_three_views_that_agree() -> None:
    signs = SignMap()
    seen(signs, "7", 2)
    [sign] = signs.signs
    assert (sign.text, sign.is_open) == (None, True)
    seen(signs, "7", 1)
    assert (sign.text, sign.is_open) == ("7", False)
    assert abs(sign.facing_rad) == pytest.approx(math.pi)


def test_views_that_disagree_leave_the_digit_open_until_one_prevails() -> None:
    signs = SignMap()
    seen(signs, "7", 3)
    seen(signs, "1", 2)
    assert signs.signs[0].text is None
    seen(signs, "7", 3)
    assert signs.signs[0].text == "7"


def test_views_of_one_post_are_one_sign_and_of_two_posts_two() -> None:
    signs = SignMap()
    seen(signs, "7", 1)
    seen(signs, "7", 1, beside_m=0.3)
    assert len(signs.signs) == 1
    assert signs.signs[0].xy_m == pytest.approx([3.0, 1.15])
    seen(signs, "2", 1, beside_m=1.5)
    assert len(signs.signs) == 2


def test_near_view_counts_more_for_the_place_than_a_far_one() -> None:
    signs = SignMap()
    signs.see("7", POST, 0.0, 1.0, 100.0)
    signs.see("7", POST + np.array([0.3, 0.0]), 0.0, 6.0, 20.0)
    assert signs.signs[0].xy_m[0] < 3.1


def test_board_with_something_else_is_refused_by_good_views_only() -> None:
    signs = SignMap()
    for _ in range(5):
        signs.see_other(POST, 2.0, 20.0, 1.0)
        signs.see_other(POST, 2.0, 60.0, 0.5)
    assert signs.signs == []
    for _ in range(3):
        signs.see_other(POST, 2.0, 60.0, 0.95)
    assert signs.signs[0].text == ""
    assert not signs.signs[0].is_open


def test_post_that_was_looked_at_from_all_sides_is_not_open() -> None:
    signs = SignMap()
    signs.see_posts(POST[None])
    [sign] = signs.signs
    for side in range(SECTORS):
        assert sign.is_open
        angle = sector_rad(side) + 0.2
        signs.look(sign, (3.0 + 2 * math.cos(angle), 1.0 + 2 * math.sin(angle)))
        assert sign.searched >> side & 1
    assert sign.searched == ALL_SECTORS
    assert not sign.is_open


def test_sides_go_once_around() -> None:
    assert [sector(sector_rad(side)) for side in range(SECTORS)] == list(range(SECTORS))
    assert sector(-0.1) == sector(math.tau - 0.1) == 0


def test_post_that_leaves_the_map_is_forgotten_unless_a_board_was_seen_there() -> None:
    signs = SignMap()
    signs.see_posts(np.array([POST, [6.0, 6.0]]))
    seen(signs, "7", 1)
    signs.see_posts(np.empty((0, 2)))
    assert [sign.views for sign in signs.signs] == [1]


def test_state_is_restored() -> None:
    signs, restored = SignMap(), SignMap()
    signs.see_posts(np.array([[6.0, 6.0]]))
    seen(signs, "7", 3)
    restored.restore(signs.state())
    assert [sign.text for sign in restored.signs] == [None, "7"]
    seen(restored, "1", 9)
    assert signs.signs[1].votes == {"7": 3}


def test_order_is_what_three_images_of_the_sheet_agree_on() -> None:
    votes = SheetVotes()
    for text in ("417", "41", "417", "4117", "417"):
        assert votes.order == ""
        votes.see(text)
    assert votes.order == "417"
    for _ in range(4):
        votes.see("123")
    assert votes.order == "417"


def test_row_with_a_digit_twice_is_no_order() -> None:
    votes = SheetVotes()
    for _ in range(5):
        votes.see("4117")
    assert votes.order == ""
