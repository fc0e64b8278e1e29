"""The trials of digits read boards and count what was right."""

from collections import Counter

from tests.workers.numbers.test_board_reader import needs_reader
from tools.trials.recognition.digits import Figures, run_signs, run_trials, summary


@needs_reader
def test_trials_count_every_board_once() -> None:
    figures = run_trials(boards=8, seed=3)
    found = summary(figures)
    assert found["boards"] == sum(counted.total() for counted in figures.digits.values()) > 4
    assert found["right_from_40_px_to_30_deg"] > 0.5


@needs_reader
def test_signs_are_believed_after_looks_from_several_places() -> None:
    figures = Figures()
    run_signs(2, 1, figures)
    counted = figures.signs
    assert counted["digits: right"] == 2
    assert counted.total() == 4
    assert figures.signs_as.total() == counted["others: wrong"]


def test_ratio_is_that_of_the_boards_asked_for() -> None:
    figures = Figures(
        digits={
            " 0° 40-60px": Counter(right=3, none=1),
            "30° 60-1000px": Counter(right=4),
            "45° 60-1000px": Counter(none=9),
            " 0° 0-30px": Counter(wrong=9),
        }
    )
    assert figures.ratio(40, 30) == 7 / 8
