"""Signs are read by several views that agree, others are refused, and posts are looked at from all sides."""

import math

import numpy as np
import pytest

from robbie_robots.workers.numbers.sign_map import (
    ALL_SECTORS,
    LOOK_RAD,
    SECTORS,
    SheetVotes,
    SignMap,
    covered,
    sector_rad,
)

POST = np.array([3.0, 1.0])


EYES = [(1.0, 1.0), (1.2, 2.0)]


def seen(signs: SignMap, text: str, times: int, *, beside_m: float = 0.0) -> None:
    """See a digit from two places in turn."""
    for number in range(times):
        signs.see(text, POST + np.array([0.0, beside_m]), math.pi, EYES[number % 2], 60.0)


def test_digit_is_sure_after_three_views_that_agree() -> None:
    signs = SignMap()
    seen(signs, "7", 2)
    [sign] = signs.signs
    assert (sign.text, sign.likely, sign.is_open) == (None, "7", True)
    seen(signs, "7", 1)
    assert (sign.text, sign.is_open) == ("7", False)
    assert abs(sign.facing_rad) == pytest.approx(math.pi)


def test_digit_is_sure_only_when_it_was_read_from_two_places() -> None:
    signs = SignMap()
    for number in range(50):
        signs.see("7", POST, math.pi, (1.0 + 0.005 * number, 1.0), 60.0)
    [sign] = signs.signs
    assert (sign.text, sign.is_open) == (None, True)
    signs.see("7", POST, math.pi, (1.0, 1.5), 60.0)
    assert sign.text == "7"


def test_views_from_far_away_make_a_digit_likely_but_not_sure() -> None:
    signs = SignMap()
    for number in range(20):
        signs.see("7", POST, math.pi, (-1.0 - 0.2 * number, 1.0), 30.0)
    [sign] = signs.signs
    assert (sign.text, sign.likely, sign.is_open) == (None, "7", True)


def test_board_that_looked_like_a_digit_from_far_away_is_refused_by_what_is_seen_from_near() -> None:
    signs = SignMap()
    for _ in range(20):
        signs.see("7", POST, math.pi, (-1.0, 1.0), 30.0)
    for number in range(4):
        signs.see_other(POST, EYES[number % 2], 60.0, 0.95)
    [sign] = signs.signs
    assert (sign.text, sign.likely, sign.times("7"), sign.is_open) == ("", "7", 20, False)


def test_board_is_not_refused_by_what_was_seen_from_one_place() -> None:
    """In one light and slant, a digit may be overlooked in every image."""
    signs = SignMap()
    for _ in range(50):
        signs.see_other(POST, EYES[0], 60.0, 0.95)
    assert signs.signs[0].text is None
    signs.see_other(POST, EYES[1], 60.0, 0.95)
    assert signs.signs[0].text == ""


def test_post_with_a_digit_that_is_not_sure_stays_open_after_looks_from_all_sides() -> None:
    signs = SignMap()
    seen(signs, "7", 1)
    [sign] = signs.signs
    sign.searched = ALL_SECTORS
    assert sign.is_open


def test_views_that_disagree_leave_the_digit_open_until_other_places_decide() -> None:
    signs = SignMap()
    seen(signs, "7", 3)
    signs.see("1", POST, math.pi, (2.0, 3.0), 60.0)
    signs.see("1", POST, math.pi, (1.0, 3.0), 60.0)
    assert signs.signs[0].text is None
    signs.see("7", POST, math.pi, (1.0, -0.5), 60.0)
    signs.see("7", POST, math.pi, (2.0, -1.0), 60.0)
    assert signs.signs[0].text == "7"


def look_from(signs: SignMap, texts: str) -> None:
    """Look from places around the post, three times from each; '-' is something else."""
    for number, text in enumerate(texts):
        angle_rad = number * math.tau / len(texts)
        eye = (POST[0] + 2 * math.cos(angle_rad), POST[1] + 2 * math.sin(angle_rad))
        for _ in range(3):
            if text == "-":
                signs.see_other(POST, eye, 60.0, 0.95)
            else:
                signs.see(text, POST, angle_rad, eye, 60.0)


def test_digit_that_is_overlooked_from_many_places_is_sure() -> None:
    """As the 1 on the ground of seed 12, which was read from 7 of 12 places."""
    signs = SignMap()
    look_from(signs, "1-1-1-1-1-11")
    assert signs.signs[0].text == "1"


def test_board_that_looks_like_a_digit_from_one_place_only_is_refused() -> None:
    """As the ring on the ground of seed 15, of which one view of 13 was a 0."""
    signs = SignMap()
    look_from(signs, "0---")
    assert signs.signs[0].text is None
    look_from(signs, "0-------")
    assert signs.signs[0].text == ""


def test_many_views_from_one_place_do_not_outvote_views_from_other_places() -> None:
    """A light or a slant may hide a digit in every image from one place."""
    signs = SignMap()
    look_from(signs, "44-")
    for _ in range(200):
        signs.see_other(POST, (POST[0] + 2.0, POST[1] + 2.0), 60.0, 0.95)
    assert signs.signs[0].text == "4"


def test_views_of_one_post_are_one_sign_and_of_two_posts_two() -> None:
    signs = SignMap()
    seen(signs, "7", 1)
    seen(signs, "7", 1, beside_m=0.3)
    assert len(signs.signs) == 1
    assert signs.signs[0].xy_m == pytest.approx([3.0, 1.15], abs=0.01)
    seen(signs, "2", 1, beside_m=1.5)
    assert len(signs.signs) == 2


def test_near_view_counts_more_for_the_place_than_a_far_one() -> None:
    signs = SignMap()
    signs.see("7", POST, 0.0, (2.0, 1.0), 100.0)
    signs.see("7", POST + np.array([0.3, 0.0]), 0.0, (-2.7, 1.0), 20.0)
    assert signs.signs[0].xy_m[0] < 3.1


def test_board_with_something_else_is_refused_by_good_views_only() -> None:
    signs = SignMap()
    for _ in range(5):
        signs.see_other(POST, EYES[0], 20.0, 1.0)
        signs.see_other(POST, EYES[1], 60.0, 0.5)
    assert signs.signs == []
    for number in range(3):
        signs.see_other(POST, EYES[number % 2], 60.0, 0.95)
    assert signs.signs[0].text == ""
    assert not signs.signs[0].is_open


def test_post_that_was_looked_at_from_all_sides_is_not_open() -> None:
    signs = SignMap()
    signs.see_posts(POST[None])
    [sign] = signs.signs
    for side in range(0, SECTORS, 2):
        assert sign.is_open
        angle = sector_rad(side) + 0.5 * math.tau / SECTORS
        signs.look(sign, (3.0 + 2 * math.cos(angle), 1.0 + 2 * math.sin(angle)))
        assert sign.searched >> side & 1
    assert sign.searched == ALL_SECTORS
    assert not sign.is_open


def test_look_covers_a_board_that_faces_it_and_none_that_it_cannot_read() -> None:
    for direction_rad in np.linspace(-math.pi, math.pi, 101).tolist():
        bits = covered(direction_rad)
        beside = [abs(math.remainder(sector_rad(side) - direction_rad, math.tau)) for side in range(SECTORS)]
        assert [bool(bits >> side & 1) for side in range(SECTORS)] == [each <= LOOK_RAD for each in beside]
        # Whatever a covered board faces between its direction and the next, it is seen at 60° at most.
        assert bits
        assert LOOK_RAD + math.tau / SECTORS / 2 < math.radians(60)


def test_post_that_leaves_the_map_is_forgotten_unless_a_board_was_seen_there() -> None:
    signs = SignMap()
    signs.see_posts(np.array([POST, [6.0, 6.0]]))
    seen(signs, "7", 1)
    signs.see_posts(np.empty((0, 2)))
    assert [sign.votes for sign in signs.signs] == [{"7": 1}]


def test_state_is_restored() -> None:
    signs, restored = SignMap(), SignMap()
    signs.see_posts(np.array([[6.0, 6.0]]))
    seen(signs, "7", 3)
    restored.restore(signs.state())
    assert [sign.text for sign in restored.signs] == [None, "7"]
    seen(restored, "1", 9)
    assert [(place.xy_m, place.votes) for place in signs.signs[1].places] == [
        (EYES[0], {"7": 2}),
        (EYES[1], {"7": 1}),
    ]


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
