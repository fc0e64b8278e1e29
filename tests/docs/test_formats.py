"""The table of formats says of each who reads or writes it, after which rules, and what was tried."""

import re

import pytest

from tests.docs._support.pages import ROOT

PAGE = (ROOT / "docs" / "formats.md").read_text()
LINES = re.findall(r"^\| (.+) \|$", PAGE, re.MULTILINE)
ROWS = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)] for line in LINES[1:]]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_row_says_what_is_left_out_by_which_rules_and_what_was_tried(row: list[str]) -> None:
    _, read, written, left_out, specification, tried = row
    assert read != "-" or written != "-"
    assert left_out and specification and tried


def test_every_format_has_one_row() -> None:
    names = [row[0] for row in ROWS]
    assert len(names) == len(set(names)) >= 14
