"""Crashes of many kinds, by somebody who has not seen the code of replay, are replayed to the same line.

A kind takes 5 to 60 s, so the test takes a sample; `python -m tests.logs.strangers_kinds` tries all.
"""

import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median

import pytest

from tests._support.robot import PROJECT
from tests.logs.strangers_kinds.kinds import KINDS
from tests.logs.strangers_kinds.trial import Outcome, attempt, table

AT_ONCE = 2
SAMPLE = KINDS[::16]


@pytest.fixture
def outcomes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Outcome]:
    """What became of each kind."""
    (tmp_path / "runtime").mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.setenv("PYTHONPATH", str(PROJECT))
    folders = [tmp_path / f"kind_{number}" for number in range(len(SAMPLE))]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(attempt, SAMPLE, folders))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_crashes_are_replayed_to_the_same_line(outcomes: list[Outcome]) -> None:
    print(table(outcomes))
    by_name = dict(zip([kind.name for kind in SAMPLE], outcomes, strict=True))
    assert [name for name, outcome in by_name.items() if not outcome.crashed] == []
    missed = {kind.name: by_name[kind.name] for kind in SAMPLE if not by_name[kind.name].replayed}
    expected = {kind.name: kind.why_not for kind in SAMPLE if kind.why_not}
    unexpected = [
        row.row()
        for name, row in missed.items()
        if name not in expected or not re.search(expected[name], row.verdict)
    ]
    assert unexpected == []
    messages = [outcome.messages for outcome in outcomes if outcome.messages is not None]
    assert median(messages) <= 5
