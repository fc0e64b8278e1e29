"""A sweep removes dead runs and nothing else, even if several run at once."""

import os
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.linux.proc import ProcessIdentity, environment_value
from robbie_mp.run.run_directory import RunDirectory, list_runs
from robbie_mp.supervisor.sweep import Swept, sweep
from robbie_mp.transport.layout import (
    HEADER_CREATOR_PID,
    HEADER_CREATOR_START,
    HEADER_MAGIC,
    HEADER_WORDS,
    MAGIC,
)
from robbie_mp.transport.shared_folder import remove_names
from tests._support.few_descriptors import only_free_descriptors
from tests.supervisor._support.running import wait_for

RUN = "0123abcd"


class Place:
    """A folder for runs and one in the place of /dev/shm."""

    def __init__(self, folder: Path):
        self.base = folder / "runs"
        self.shared_memory = folder / "shm"
        self.base.mkdir(mode=0o700)
        self.shared_memory.mkdir()

    def sweep(self) -> Swept:
        return sweep([self.base, self.base / "missing"], self.shared_memory)

    def names(self) -> list[str]:
        return sorted(path.name for path in self.shared_memory.rglob("*") if not path.is_dir())

    def add_names(self, run_id: str) -> None:
        """Add a segment and a semaphore, new now; to make them old, move the clock (`later`)."""
        (self.shared_memory / f"robbie-{run_id}").mkdir(mode=0o700)
        for name in (f"robbie-{run_id}/core", f"sem.robbie-{run_id}.{0:016x}"):
            (self.shared_memory / name).touch(mode=0o600)

    def add_board(self, run_id: str, supervisor: ProcessIdentity, magic: int = MAGIC) -> None:
        words = [0] * HEADER_WORDS
        words[HEADER_MAGIC] = magic
        words[HEADER_CREATOR_PID] = supervisor.pid
        words[HEADER_CREATOR_START] = supervisor.start_ticks
        board = self.shared_memory / f"robbie-{run_id}" / "board"
        board.parent.mkdir(mode=0o700, exist_ok=True)
        board.touch(mode=0o600)
        board.write_bytes(struct.pack(f"<{HEADER_WORDS}Q", *words))


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


@pytest.fixture
def later(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the wall clock be two minutes ahead."""
    now = time.time
    monkeypatch.setattr(time, "time", lambda: now() + 120.0)


@pytest.fixture
def gone() -> ProcessIdentity:
    """Return a process that has ended."""
    with subprocess.Popen(["sleep", "60"]) as process:
        stat = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        process.kill()
    return ProcessIdentity(process.pid, int(stat[19]))


def test_dead_run_is_removed_with_its_names(place: Place) -> None:
    (place.base / RUN).mkdir()
    (place.base / RUN / "run.json").write_text("{}")
    place.add_names(RUN)
    (place.shared_memory / "robbie-0123abcdef-not-ours").touch()
    (place.shared_memory / "somebody-else").touch()
    names = f"robbie-{RUN}/core", f"robbie-{RUN}", f"sem.robbie-{RUN}.{0:016x}"
    assert place.sweep() == Swept((RUN,), names)
    assert place.names() == ["robbie-0123abcdef-not-ours", "somebody-else"]
    assert list(place.base.iterdir()) == []
    assert place.sweep() == Swept()


def test_live_run_is_left_alone_at_any_age(place: Place, tmp_path: Path, later: None) -> None:
    run = RunDirectory.create("arena", tmp_path, place.base)
    place.add_names(run.run_id)
    assert place.sweep() == Swept()
    run.remove()


def test_process_of_a_dead_run_is_killed(place: Place) -> None:
    (place.base / RUN).mkdir()
    with subprocess.Popen(["sleep", "60"], env={**os.environ, "ROBBIE_CHILD": f"{RUN}/laser/3"}) as process:
        # Popen returns while exec(2) is still at work: the kernel shows the new environment a little later.
        wait_for(lambda: environment_value(process.pid, "ROBBIE_CHILD") is not None)
        assert place.sweep().processes == (process.pid,)
        assert process.wait() == -9


@pytest.mark.usefixtures("later")
def test_names_without_folder_are_removed_if_the_supervisor_on_their_board_is_gone(
    place: Place, gone: ProcessIdentity
) -> None:
    place.add_names(RUN)
    place.add_board(RUN, gone)
    assert place.sweep().runs == (RUN,)
    assert place.names() == []


@pytest.mark.usefixtures("later")
def test_names_without_folder_are_kept_while_the_supervisor_on_their_board_lives(place: Place) -> None:
    place.add_names(RUN)
    place.add_board(RUN, ProcessIdentity.own())
    assert place.sweep() == Swept()
    assert len(place.names()) == 3


@pytest.mark.usefixtures("later")
@pytest.mark.parametrize("free", [1, 2, 3])
def test_sweep_with_few_free_descriptors_keeps_a_live_run(place: Place, free: int) -> None:
    place.add_names(RUN)
    place.add_board(RUN, ProcessIdentity.own())
    with only_free_descriptors(free):
        assert place.sweep() == Swept()
    assert len(place.names()) == 3


def test_reused_pid_does_not_keep_names(place: Place) -> None:
    own = ProcessIdentity.own()
    place.add_board(RUN, ProcessIdentity(own.pid, own.start_ticks + 1))
    assert place.sweep().runs == (RUN,)


def test_recent_names_without_board_are_kept_for_a_starting_run(place: Place) -> None:
    place.add_names(RUN)
    place.add_board(RUN, ProcessIdentity.own(), magic=0)
    assert place.sweep() == Swept()
    assert len(place.names()) == 3


@pytest.mark.usefixtures("later")
def test_old_names_without_board_are_removed(place: Place) -> None:
    place.add_names(RUN)
    place.add_board(RUN, ProcessIdentity.own(), magic=0)
    assert place.sweep().runs == (RUN,)


@pytest.mark.usefixtures("later")
def test_board_that_is_not_our_file_is_ignored(place: Place) -> None:
    (place.shared_memory / f"robbie-{RUN}").mkdir(mode=0o700)
    os.mkfifo(place.shared_memory / f"robbie-{RUN}" / "board")
    assert place.sweep().runs == (RUN,)


@pytest.mark.usefixtures("later")
def test_names_of_another_user_are_left_alone(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    place.add_names(RUN)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert place.sweep() == Swept()
    assert len(place.names()) == 2


def test_unfinished_folder_is_removed_only_when_it_is_old(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    (place.base / "new-0123abcd").mkdir()
    place.sweep()
    assert (place.base / "new-0123abcd").exists()
    now = time.time
    monkeypatch.setattr(time, "time", lambda: now() + 120.0)
    place.sweep()
    assert not (place.base / "new-0123abcd").exists()


def test_two_sweeps_at_once_sweep_a_run_only_once(place: Place) -> None:
    for number in range(20):
        (place.base / f"{number:08x}").mkdir()
        place.add_names(f"{number:08x}")
    results: list[Swept] = []
    threads = [threading.Thread(target=lambda: results.append(place.sweep())) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    swept = [run for result in results for run in result.runs]
    assert sorted(swept) == [f"{number:08x}" for number in range(20)]
    assert place.names() == []


@pytest.fixture
def sweepers(place: Place) -> Iterator[list[Swept]]:
    """Sweep all the time in two threads."""
    over = threading.Event()
    results: list[Swept] = []

    def go_on() -> None:
        while not over.is_set():
            results.append(place.sweep())

    threads = [threading.Thread(target=go_on) for _ in range(2)]
    for thread in threads:
        thread.start()
    yield results
    over.set()
    for thread in threads:
        thread.join()


@pytest.mark.slow
def test_sweeps_do_not_affect_runs_that_start_and_end_meanwhile(
    place: Place, tmp_path: Path, sweepers: list[Swept]
) -> None:
    for _ in range(100):
        run = RunDirectory.create("arena", tmp_path, place.base)
        place.add_names(run.run_id)
        place.add_board(run.run_id, ProcessIdentity.own())
        assert len(place.names()) == 3
        assert [found.is_live for found in list_runs([place.base])] == [True]
        remove_names(run.run_id, place.shared_memory)
        run.remove()
    assert len(sweepers) > 2
    assert not any(result.runs for result in sweepers)
