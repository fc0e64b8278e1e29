"""The table of the measurement of many robots at one router."""

from tools.link.scale.__main__ import Figures, row


def test_row_has_a_cell_for_each_figure() -> None:
    figures = Figures("star", 10, 1.0, 0.955, 1.44, 4.9, 798.2, 6.2, 2.04, 12.0)
    assert row(figures) == "| star | 10 | 100% | 95.5% | 1.4, 4.9 | 798 | 6 % | 2.0 % | 12 % |"
