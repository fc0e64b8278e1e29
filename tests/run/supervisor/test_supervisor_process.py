"""What happens to children when the supervisor is another process: killed, or interrupted from a terminal."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.run.run_directory import list_runs
from robbie_mp.run.supervisor.sweep import Swept, sweep
from robbie_mp.run.trace.entry import Entry
from tests._support.places import PROJECT
from tests.run.supervisor._support import supervise
from tests.run.supervisor._support.running import is_gone, wait_for


@contextmanager
def supervisor(tmp_path: Path, *behaviours: str, terminal: str = "-") -> Iterator["subprocess.Popen[str]"]:
    """Start a supervisor; nothing of it is left afterwards, whatever the test does."""
    arguments = [str(tmp_path / "runs"), str(tmp_path), terminal, *behaviours]
    process = subprocess.Popen(
        [sys.executable, supervise.__file__, *arguments],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        start_new_session=True,
    )
    try:
        with process:
            try:
                yield process
            finally:
                process.kill()
    finally:
        sweep([tmp_path / "runs"])


def ready(process: "subprocess.Popen[str]") -> tuple[str, list[int]]:
    """Wait until all children run; return the run id and their pids."""
    assert process.stdout
    run_id, *pids = process.stdout.readline().split()
    return run_id, [int(pid) for pid in pids]


def swept_of(run_id: str, folder: Path) -> Swept:
    """Sweep; return what belonged to a run. A sweep also finds what other tests have left at that moment."""
    swept = sweep([folder / "runs"])
    names = tuple(name for name in swept.names if run_id in name)
    return replace(swept, names=names) if names or swept.runs else Swept()


def test_children_of_a_killed_supervisor_die_and_a_sweep_removes_the_rest(tmp_path: Path) -> None:
    with supervisor(tmp_path, "works", "ignores_sigterm", "forks") as process:
        run_id, children = ready(process)
        forked = [int(pid) for pid in (tmp_path / "ready" / "forks.1.forked").read_text().split()]
        assert swept_of(run_id, tmp_path) == Swept(), "a live run was swept"
        process.kill()
        process.wait()
        wait_for(lambda: all(map(is_gone, children)), limit_s=1.0)
        assert [run.is_live for run in list_runs([tmp_path / "runs"])] == [False]
        swept = swept_of(run_id, tmp_path)
        assert swept.runs == (run_id,)
        assert swept.names == (f"robbie-{run_id}/board", f"robbie-{run_id}/home", f"robbie-{run_id}")
        assert set(swept.processes) == set(forked), "the kernel does not kill what children forked"
        assert all(map(is_gone, forked))
        assert list((tmp_path / "runs").iterdir()) == []
        assert not list(SHARED_MEMORY.glob(f"*{run_id}*"))


def test_stop_by_sigterm_leaves_nothing_to_sweep(tmp_path: Path) -> None:
    with supervisor(tmp_path, "works", "forks") as process:
        run_id, children = ready(process)
        process.terminate()
        assert process.wait() == 0
        assert all(map(is_gone, children))
        assert list_runs([tmp_path / "runs"]) == []
        assert swept_of(run_id, tmp_path) == Swept()


def _printed(folder: Path) -> list[str]:
    lines = (folder / "logs" / "notes_signals.jsonl").read_bytes().splitlines()
    entries = [Entry.from_line(line) for line in lines]
    return [entry.text for entry in entries if entry and entry.stream == "stdout"]


def test_interrupt_of_the_terminal_reaches_only_the_supervisor(tmp_path: Path) -> None:
    controller, terminal = os.openpty()
    try:
        with supervisor(tmp_path, "notes_signals", terminal=os.ttyname(terminal)) as process:
            ready(process)
            os.write(controller, b"\x03")
            assert process.wait() == 0
    finally:
        os.close(controller)
        os.close(terminal)
    assert _printed(tmp_path) == [signal.Signals.SIGTERM.name]


def test_closed_terminal_stops_the_run_in_order(tmp_path: Path) -> None:
    controller, terminal = os.openpty()
    with supervisor(tmp_path, "notes_signals", terminal=os.ttyname(terminal)) as process:
        ready(process)
        os.close(terminal)
        os.close(controller)
        assert process.wait() == 0
    assert _printed(tmp_path)[-1] == signal.Signals.SIGTERM.name
