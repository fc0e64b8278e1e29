"""A narrow terminal loses columns and ends of texts, never digits."""

import io
import re
from collections.abc import Sequence

import pytest
from rich.console import RenderableType
from rich.text import Text

from robbie_mp.attached.views import process_table, run_figures
from robbie_mp.attached.views.plain_table import PlainTable
from robbie_mp.attached.views.process_table import modules_table
from robbie_mp.attached.views.run_figures import FIGURES, table
from robbie_mp.bus.observe import rates_between
from robbie_mp.cli.output import PlainConsole
from tests.cli._support.readings import laser, mapping, reading


def printed(renderable: RenderableType, width: int) -> list[str]:
    file = io.StringIO()
    PlainConsole(file, width).print(renderable)
    lines = [line.rstrip() for line in file.getvalue().splitlines()]
    assert max(map(len, lines)) <= width, lines
    return lines


def numbers(renderable: RenderableType) -> set[str]:
    """All words with digits of the whole table."""
    return set(re.findall(r"\S*\d\S*", "\n".join(printed(renderable, 500))))


def example() -> PlainTable:
    made = PlainTable()
    made.add_column("topic", shrinks=True, no_wrap=True)
    made.add_column("version", left_out=1, justify="right", no_wrap=True)
    made.add_column("messages", justify="right", no_wrap=True)
    made.add_column("bytes", left_out=2, justify="right", no_wrap=True)
    made.add_row("front/camera/rectified/colour", "1", "123456789", "9876543210123")
    made.add_row("odom", "12", "5", "7")
    return made


@pytest.mark.parametrize(
    ("width", "expected"),
    [
        (100, ["topic", "version", "messages", "bytes"]),
        (50, ["topic", "version", "messages", "bytes"]),
        (40, ["topic", "messages", "bytes"]),
        (30, ["topic", "messages"]),
    ],
)
def test_columns_are_left_out_in_the_declared_order(width: int, expected: list[str]) -> None:
    lines = printed(example(), width)
    assert lines[0].split() == expected
    assert len(lines) == 3
    assert "123456789" in lines[1].split()
    assert ("9876543210123" in lines[1].split()) == ("bytes" in expected)
    assert lines[1].startswith("front/camera/rectified/colour"[: 10 if width < 60 else 29])


def test_table_that_declares_nothing_wraps_as_before() -> None:
    made = PlainTable("a", "b")
    made.add_row("word " * 10, Text("other"))
    assert len(printed(made, 30)) > 2


def tables(status: str) -> Sequence[PlainTable]:
    before, now = (
        reading(at_s, laser(at_s, status=status), mapping(at_s, status=status)) for at_s in (1000.0, 2000.0)
    )
    return (
        modules_table(now, rates_between(before, now)),
        table(now.modules, live=False),
        table(now.modules, live=True, columns=run_figures.LIVE_FIGURES),
    )


@pytest.mark.parametrize("width", [60, 80])
def test_tables_of_a_run_cut_no_number(width: int) -> None:
    for number, one in enumerate(tables("a long status line that goes on and on " * 3)):
        lines = printed(one, width)
        shown = [word for line in lines[1:] for word in re.findall(r"\S*\d\S*", line)]
        assert len(shown) >= 2, lines
        assert set(shown) <= numbers(one), (number, lines)
        assert not any("…" in word for word in shown)
        assert len({line.count("RUNNING") for line in lines}) <= 2


def test_every_column_with_an_order_exists() -> None:
    assert set(run_figures.LEFT_OUT) == set(FIGURES)
    assert set(process_table.LEFT_OUT) < set(process_table.PRINTED)
