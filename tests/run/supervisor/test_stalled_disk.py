"""A stalled disk delays neither the supervisor, nor modules that print, nor a stop."""

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import pytest

from robbie_mp.run.profile.model import TraceSettings
from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.trace import disk_writer
from robbie_mp.run.trace.disk_writer import DiskWriter
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.reader import entries, last_entries
from tests._support.disks import freezable_disk
from tests._support.places import PROJECT
from tests._support.robot import Ended, Robot, wait_until
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import Run, Scenario, animal, wait_for
from tools.loop_disk import LoopDisk

pytestmark = [pytest.mark.slow, pytest.mark.alone]

RUNNING = ChildState.RUNNING
END_LIMIT_S = 15.0
PROFILE = """
modules:
  one: {class: zoo.modules:Idle}
  two: {class: zoo.modules:Idle}
"""


class Stall(Protocol):
    """A way to stall the disk of a run."""

    folder: Path

    def freeze(self) -> None: ...

    def thaw(self) -> None: ...


class StoppedWriter:
    """The alternative if no disk can be frozen: the writer process is stopped."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.run: Run | None = None

    def freeze(self) -> None:
        self._send(signal.SIGSTOP)

    def thaw(self) -> None:
        self._send(signal.SIGCONT)

    def _send(self, number: signal.Signals) -> None:
        assert self.run is not None
        for pid in self.run.tree.output.disk.pids:
            os.kill(pid, number)


@pytest.fixture(params=["frozen disk", "stopped writer"])
def stall(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Stall]:
    logs = tmp_path / "logs"
    logs.mkdir()
    if request.param == "frozen disk":
        with freezable_disk(logs) as disk:
            yield disk
    else:
        yield StoppedWriter(logs)


def started(folder: Path, stall: Stall, *behaviours: object, limits: TraceSettings | None = None) -> Run:
    run = Run(folder, *(animal(behaviour) for behaviour in behaviours), limits=limits)  # type: ignore[arg-type]
    if isinstance(stall, StoppedWriter):
        stall.run = run
    return run


def written(folder: Path, module: str) -> list[Entry]:
    (folder / "log").symlink_to(folder / "logs")  # where a reader looks for it
    return list(entries(folder, [module]))


def test_supervision_and_output_continue_while_the_disk_is_stalled(tmp_path: Path, stall: Stall) -> None:
    run = started(tmp_path, stall, zoo.works, zoo.works_busily)
    turned_s: list[float] = []
    run.each_turn = lambda: turned_s.append(time.monotonic())

    def scenario() -> Scenario:
        yield run.all_running
        stall.freeze()
        turned_s.clear()
        said = len(run.text("works_busily", "stdout"))
        os.kill(run.incarnations.pids["works", 1], signal.SIGKILL)
        yield lambda: run.states("works").count(RUNNING) == 2
        yield lambda: len(run.text("works_busily", "stdout")) > said + 50
        yield lambda: any("has stalled" in text for text in run.text("supervisor", "supervisor"))
        longest_s = max(after - before for before, after in itertools.pairwise(turned_s))
        assert longest_s < 2.0  # the disk is frozen until the next line
        stall.thaw()
        yield lambda: any("has recovered" in text for text in run.text("supervisor", "supervisor"))
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    kept = [entry for entry in run.lines if entry.module == "works_busily"]
    assert written(tmp_path, "works_busily") == kept, "lost though there was room"
    assert run.tree.child("works_busily").output.dropped == 0
    reports = [entry.crash_report for entry in run.lines if entry.crash_report]
    assert len(reports) == 1
    assert (run.logs / reports[0]).exists()


def test_output_waiting_for_a_stalled_disk_is_bounded_and_the_rest_is_counted(
    tmp_path: Path, stall: Stall
) -> None:
    limits = TraceSettings(waiting_bytes=1 << 16, lines_per_s=1e6, burst_lines=1_000_000)
    run = started(tmp_path, stall, zoo.works_busily, limits=limits)

    def scenario() -> Scenario:
        yield run.all_running
        stall.freeze()
        yield lambda: run.tree.child("works_busily").output.dropped > 100
        stall.thaw()
        dropped = run.tree.child("works_busily").output.dropped
        turns = run.turns
        yield lambda: run.turns > turns + 50
        assert run.tree.child("works_busily").output.dropped - dropped <= dropped
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    made = run.tree.child("works_busily").output
    assert len(written(tmp_path, "works_busily")) == made.lines - made.dropped


def test_ordered_stop_with_a_stalled_disk_is_bounded_and_losses_are_counted(
    tmp_path: Path, stall: Stall, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DiskWriter.close, "__defaults__", (0.3,))
    run = started(tmp_path, stall, zoo.works_busily)
    writers: set[int] = set()
    stopped_s = 0.0

    def scenario() -> Scenario:
        nonlocal stopped_s
        yield run.all_running
        stall.freeze()
        writers.update(run.tree.output.disk.pids)
        said = len(run.text("works_busily", "stdout"))
        yield lambda: len(run.text("works_busily", "stdout")) > said + 20
        stopped_s = time.monotonic()
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    assert time.monotonic() - stopped_s < 3.0
    assert run.tree.output.disk.unfinished > 0
    assert run.tree.child("works_busily").output.dropped > 20
    if isinstance(stall, StoppedWriter):
        for pid in writers:
            os.kill(pid, signal.SIGCONT)
    else:
        stall.thaw()
    for pid in writers:
        os.waitpid(pid, 0)  # it is still ours, as it would be of init if we had ended
    assert written(tmp_path, "works_busily"), "not written in the end, though the disk is back"


def test_dead_writer_is_replaced_and_its_unwritten_output_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk_writer, "RESTART_PERIOD_S", 0.0)
    run = Run(tmp_path, animal(zoo.works_busily))

    def scenario() -> Scenario:
        yield run.all_running
        (first,) = run.tree.output.disk.pids
        os.kill(first, signal.SIGSTOP)
        said = len(run.text("works_busily", "stdout"))
        yield lambda: len(run.text("works_busily", "stdout")) > said + 20
        os.kill(first, signal.SIGKILL)
        yield lambda: not run.tree.output.disk.pids & {first} and run.tree.output.disk.pids != set()
        said = len(run.text("works_busily", "stdout"))
        yield lambda: len(run.text("works_busily", "stdout")) > said + 20
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0
    made = run.tree.child("works_busily").output
    assert made.dropped > 20
    assert len(written(tmp_path, "works_busily")) >= made.lines - made.dropped
    assert (tmp_path / "logs" / "trace.html").exists()
    assert not (tmp_path / "logs" / "trace.1.html").exists(), "a page was begun again within a run"


def test_output_passed_to_the_writer_is_written_even_if_the_supervisor_is_killed(tmp_path: Path) -> None:
    script = (
        "import os, signal\n"
        "from pathlib import Path\n"
        "from robbie_mp.run.supervisor.output import OutputStore\n"
        "store = OutputStore(Path('logs'))\n"
        "store.child('laser').add('stdout', [str(number) for number in range(3000)])\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=dict(os.environ, PYTHONPATH=str(PROJECT)),
        check=False,
    )
    file = tmp_path / "logs" / "laser.jsonl"
    wait_for(lambda: file.exists() and len(file.read_bytes().splitlines()) == 3000)


def test_run_on_a_frozen_disk_restarts_its_modules_and_ends_in_order(
    robot: Robot, disk: LoopDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its output is there and the run's own folder, too."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(disk.folder))
    robot.output = disk.folder / "out"
    robot.write_profile(PROFILE)
    process = robot.start()
    figures = robot.until(lambda modules: all(module["state"] == "RUNNING" for module in modules.values()))
    run_folder = robot.known_run().folder
    disk.freeze()
    os.kill(figures["one"]["pid"], signal.SIGKILL)
    again = robot.until(
        lambda modules: modules["one"]["state"] == "RUNNING" and modules["one"]["restarts"] == 1
    )
    assert again["one"]["pid"] != figures["one"]["pid"]
    begin_s = time.monotonic()
    process.send_signal(signal.SIGINT)
    ended = Ended.wait_for(process)
    assert time.monotonic() - begin_s < END_LIMIT_S
    assert ended.exit_code == 0
    assert f"the disk of {robot.output} has stalled" in ended.stderr
    assert not (robot.output / "summary.json").exists()
    assert run_folder.exists()
    disk.thaw()  # and what was handed over is written, and removed, after all
    wait_until(lambda: not run_folder.exists())
    assert (robot.output / "summary.json").exists()
    assert any("crashed" in entry.text for entry in last_entries(robot.output, "one", 100))
