"""`robbie log`: the right entries, harmless to the terminal."""

import json
from pathlib import Path

import pytest

from robbie_mp.cli import log, main
from robbie_mp.run.profile.model import TraceSettings
from robbie_mp.run.supervisor.output import OutputStore
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind


@pytest.fixture
def output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The output directory of a run that is over."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    folder = tmp_path / "output" / "demo" / "now"
    store = OutputStore(folder / "log", limits=TraceSettings())
    laser, mapping = store.child("laser"), store.child("mapping")
    laser.begin(2)
    laser.add("stdout", [f"scan {number}" for number in range(30)])
    mapping.add("stderr", ["no \x1b[2Jmap"])
    record = {"text": "bad\nscan", "level": 40, "logger": "driver", "traceback": "Traceback\n  boom"}
    laser.add_records([json.dumps(record).encode()])
    laser.say(Kind.SYSTEM, "RUNNING → BACKOFF")
    for closed in (laser, mapping, store):
        closed.close()
    return folder


def test_log_shows_the_trace_of_the_newest_run(output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert shown(capsys) == shown(capsys, str(output))
    assert shown(capsys, "--last", "1") == shown(capsys)[-1:]


def shown(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    assert main(["log", *arguments]) == 0
    return capsys.readouterr().out.splitlines()


def test_newest_run_is_shown_in_order_with_more_lines_indented(
    output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = shown(capsys)
    assert lines[0].endswith(" laser#2 info scan 0")
    assert [line.split(" ", 1)[1] for line in lines[30:32]] == [
        "mapping#0 warning no \\x1b[2Jmap",
        "laser#2 error driver: bad",
    ]
    assert lines[32:35] == ["    scan", "    Traceback", "      boom"]
    assert lines[35].endswith("laser#2 system RUNNING → BACKOFF")
    assert shown(capsys, str(output)) == lines


def test_entries_can_be_chosen_by_kind_module_and_number(
    output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    [line] = shown(capsys, "--kind", "error,warning", "--module", "mapping")
    assert line.endswith("mapping#0 warning no \\x1b[2Jmap")
    assert [line.split()[-1] for line in shown(capsys, "--kind", "info", "--last", "2")] == ["28", "29"]
    assert shown(capsys, "--kind", "error", "--module", "mapping") == []


def test_json_output_is_the_entries(output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    entries = [Entry.from_line(line.encode()) for line in shown(capsys, "--json", "--kind", "error")]
    assert [entry and entry.text for entry in entries] == ["bad\nscan"]


def test_following_an_ended_run_shows_its_end_and_ends(
    output: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log, "POLL_S", 0.0)
    lines = shown(capsys, "--follow", "--last", "1", str(output))
    assert len(lines) == 1
    assert len(shown(capsys, "--follow", str(output))) == log.FOLLOWED_LINES + 3


def test_colours_are_used_only_on_terminals_and_if_wanted(
    output: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = shown(capsys)
    assert "\x1b" not in "".join(plain)
    monkeypatch.setenv("FORCE_COLOR", "1")  # as if on a terminal
    coloured = shown(capsys)
    assert "\x1b[1;31merror driver: bad" in "".join(coloured)
    assert "\x1b[2J" not in "".join(coloured)
    monkeypatch.setenv("NO_COLOR", "1")
    assert shown(capsys) == plain


def test_unknown_modules_and_invalid_run_folders_are_reported(
    output: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["log", "--module", "lazer"]) == 1
    assert "did you mean 'laser'" in capsys.readouterr().err
    assert main(["log", str(tmp_path)]) == 1
    assert "is not the output directory of a run" in capsys.readouterr().err
    assert main(["log", "--record", "error"]) == 1
    assert "no run on this machine" in capsys.readouterr().err
    (output / "log").rename(output / "gone")
    assert main(["log"]) == 1
    assert "none in ./output" in capsys.readouterr().err
