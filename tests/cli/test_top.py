"""`robbie top` as a command: when it ends, and its messages."""

import contextlib
import dataclasses
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from robbie_mp.attached.views.process_table import totals_line
from robbie_mp.cli import main
from tests._support.robot import COMMAND
from tests.cli._support.readings import reading

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def no_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robbie_mp.run.live_runs.list_runs", lambda: [])
    tmp_path.chmod(0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.mark.parametrize("option", ["--once", "--json", "--csv=-"])
def test_missing_run_is_reported(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["top", option]) == 1
    assert capsys.readouterr().err == "no run on this machine; start one with `robbie run PROFILE`\n"


def test_missing_library_is_reported_with_advice(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.startswith("robbie_mp.cli.top_program")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "textual", None)
    monkeypatch.setitem(sys.modules, "textual.app", None)
    assert main(["top"]) == 1
    said = capsys.readouterr().err
    assert "`pip install textual`" in said
    assert "--json" in said


def test_printed_figures_do_not_need_textual() -> None:
    code = "import sys; import robbie_mp.cli.top; sys.exit('textual' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


def test_missing_terminal_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["top"]) == 1
    assert "needs a terminal" in capsys.readouterr().err


def test_latched_messages_that_new_subscribers_missed_are_shown() -> None:
    now = reading(1.0)
    assert "LATCHED" not in totals_line(now, None).plain
    core = dataclasses.replace(now.core, latched_not_given=2)
    assert "2 LATCHED NOT GIVEN" in totals_line(dataclasses.replace(now, core=core), None).plain


def test_invalid_interval_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as error:
        main(["top", "--once", "--interval", "-1"])
    assert error.value.code == 2
    assert "expected 0 s to 1e+09 s; got -1" in capsys.readouterr().err


def test_top_waits_for_a_run_until_q_is_pressed() -> None:
    controller, terminal = pty.openpty()
    with subprocess.Popen(
        [*COMMAND, "top", "--run", "none"], stdin=terminal, stdout=terminal, stderr=terminal, cwd=ROOT
    ) as process:
        os.close(terminal)
        try:
            seen = b""
            while b"no such run" not in seen:
                seen += os.read(controller, 1 << 16)
            os.write(controller, b"q")
            with contextlib.suppress(OSError):  # no process has the terminal open any more
                while os.read(controller, 1 << 16):
                    pass
            assert process.wait(30) == 0
        finally:
            process.kill()
            os.close(controller)
