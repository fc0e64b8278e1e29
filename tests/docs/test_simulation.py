"""The examples in docs/simulation.md work, and its table names the modules of the profile `simulation`."""

import re
from pathlib import Path

import pytest

from robbie_mp.run.profile.load import load_profile
from robbie_mp.run.profile.preflight import preflight
from robbie_robots.hw.simulation import generate_arena
from robbie_robots.hw.simulation.arena_file import read_arena
from tests.docs._support.pages import ROOT, block

PAGE = (ROOT / "docs" / "simulation.md").read_text()


def test_arena_on_the_page_is_valid(tmp_path: Path) -> None:
    (tmp_path / "arena.yaml").write_text(block("docs/simulation.md", "arena"))
    arena = read_arena(tmp_path / "arena.yaml")
    assert (len(arena.victims), len(arena.signs), len(arena.appearing)) == (2, 1, 2)


def test_command_on_the_page_writes_an_arena(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (words,) = re.findall(
        r"^    python -m robbie_robots.hw.simulation.generate_arena (.*) > arena.yaml", PAGE, re.MULTILINE
    )
    assert generate_arena.main(words.split()) == 0
    (tmp_path / "arena.yaml").write_text(capsys.readouterr().out)
    assert read_arena(tmp_path / "arena.yaml").victims


def test_table_names_all_devices_of_the_profile_and_the_profile_is_valid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(ROOT)
    profile = load_profile("simulation")
    assert not preflight(profile, timeout_s=60.0).failures
    named = re.findall(r"^\| [^|]+ \| `(robbie_robots\.modules\.[\w.]+:\w+)`", PAGE, re.MULTILINE)
    assert sorted(module.class_path for module in profile.modules) == sorted(named)
