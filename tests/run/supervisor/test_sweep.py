"""A sweep removes dead runs and nothing else, even if several run at once."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from robbie_mp.base.linux.proc import environment_value
from robbie_mp.run.run_directory import RunDirectory, list_runs
from robbie_mp.run.supervisor.sweep import Swept, dead_runs, sweep
from tests._support.few_descriptors import only_free_descriptors
from tests._support.places import PROJECT
from tests.run.supervisor._support.running import wait_for

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
        # Not by rglob, which fails where a sweep removes a folder meanwhile.
        return sorted(name for _, _, names in os.walk(self.shared_memory) for name in names)

    def add_names(self, run_id: str) -> None:
        """Add a segment."""
        (self.shared_memory / f"robbie-{run_id}").mkdir(mode=0o700, exist_ok=True)
        (self.shared_memory / f"robbie-{run_id}/core").touch(mode=0o600)

    def create(self) -> RunDirectory:
        """Create a live run with names."""
        run = RunDirectory.create("arena", self.base.parent, self.base, self.shared_memory)
        self.add_names(run.run_id)
        return run


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


def test_folder_that_a_module_made_among_the_names_of_a_dead_run_is_removed(place: Place) -> None:
    """The run's folder in /dev/shm stayed for ever."""
    place.add_names(RUN)
    folder = place.shared_memory / f"robbie-{RUN}"
    (folder / "own" / "deeper").mkdir(parents=True)
    (folder / "own" / "deeper" / "file").touch()
    (folder / "link").symlink_to(place.base)
    assert place.sweep().runs == (RUN,)
    assert not folder.exists()
    assert place.base.exists()


def test_dead_run_is_removed_with_its_names(place: Place) -> None:
    (place.base / RUN).mkdir()
    (place.base / RUN / "run.json").write_text("{}")
    place.add_names(RUN)
    (place.shared_memory / "robbie-0123abcdef-not-ours").touch()
    (place.shared_memory / "somebody-else").touch()
    names = f"robbie-{RUN}/core", f"robbie-{RUN}"
    assert place.sweep() == Swept((RUN,), names)
    assert place.names() == ["robbie-0123abcdef-not-ours", "somebody-else"]
    assert list(place.base.iterdir()) == []
    assert place.sweep() == Swept()


@pytest.mark.parametrize("hidden", ["nothing", "the folder for runs", "/dev/shm"])
def test_live_run_is_left_alone_by_who_sees_only_one_of_its_folders(
    place: Place, tmp_path: Path, hidden: str
) -> None:
    """Containers may share /dev/shm and not /tmp, or the other way round."""
    run = place.create()
    (tmp_path / "empty").mkdir()
    base = tmp_path / "empty" if hidden == "the folder for runs" else place.base
    shared_memory = tmp_path / "empty" if hidden == "/dev/shm" else place.shared_memory
    assert sweep([base], shared_memory) == Swept()
    assert len(place.names()) == 1
    assert run.folder.exists()
    assert dead_runs([base], shared_memory) == []
    run.remove()
    assert place.names() == []


SWEEP = """
import sys
from pathlib import Path
from robbie_mp.run.supervisor.sweep import sweep
print(sweep([Path(sys.argv[1])], Path(sys.argv[2])).runs)
"""


def test_live_run_is_left_alone_by_a_container_that_sees_other_processes(
    place: Place, tmp_path: Path
) -> None:
    """As with `docker run --ipc=host`: another PID namespace with the same /dev/shm."""
    other_processes = ["unshare", "--pid", "--fork", "--mount-proc"]
    if subprocess.run([*other_processes, "true"], check=False, capture_output=True).returncode:
        pytest.skip("NOT TESTED, no PID namespace can be made here: it needs root")
    run = place.create()
    place.add_names(RUN)  # a dead run
    swept = subprocess.run(
        [*other_processes, sys.executable, "-c", SWEEP, tmp_path / "empty", place.shared_memory],
        check=True, capture_output=True, cwd=PROJECT,
    )  # fmt: skip
    assert swept.stdout.decode() == f"('{RUN}',)\n"
    assert len(place.names()) == 1
    run.remove()


def test_process_of_a_dead_run_is_killed(place: Place) -> None:
    (place.base / RUN).mkdir()
    with subprocess.Popen(["sleep", "60"], env={**os.environ, "ROBBIE_CHILD": f"{RUN}/laser/3"}) as process:
        # Popen returns while exec(2) is still at work: the kernel shows the new environment a little later.
        wait_for(lambda: environment_value(process.pid, "ROBBIE_CHILD") is not None)
        assert place.sweep().processes == (process.pid,)
        assert process.wait() == -9


def die(run: RunDirectory) -> None:
    """Release a run's locks, as its supervisor does when it is killed."""
    for lock_fd in run._lock_fds:
        os.close(lock_fd)


def test_dead_run_of_a_session_with_another_runtime_directory_is_found_with_its_folder(
    place: Place, tmp_path: Path
) -> None:
    """Its black box was removed without a clip, by a `robbie run` from cron."""
    run = place.create()
    die(run)
    salvaged = []
    sweep([tmp_path / "other"], place.shared_memory, lambda *found: salvaged.append(found))
    assert salvaged == [(run.run_id, run.folder)]
    assert not run.folder.exists()


def test_folder_that_others_can_write_to_is_not_taken_for_that_of_a_run(place: Place, tmp_path: Path) -> None:
    run = place.create()
    place.base.chmod(0o777)
    die(run)
    assert sweep([tmp_path / "other"], place.shared_memory).runs == (run.run_id,)
    assert run.folder.exists()


@pytest.mark.parametrize("kind", ["a folder of another name", "a file"])
def test_home_that_a_module_has_replaced_is_not_believed(place: Place, tmp_path: Path, kind: str) -> None:
    run = place.create()
    home = place.shared_memory / f"robbie-{run.run_id}" / "home"
    home.unlink()
    if kind == "a file":
        home.touch()
    else:
        home.symlink_to(tmp_path / "important")
        (tmp_path / "important").mkdir()
    die(run)
    assert sweep([tmp_path / "other"], place.shared_memory).runs == (run.run_id,)
    assert kind == "a file" or (tmp_path / "important").exists()
    assert run.folder.exists()


def test_names_without_folder_are_removed(place: Place) -> None:
    place.add_names(RUN)
    assert place.sweep().runs == (RUN,)
    assert place.names() == []


@pytest.mark.parametrize("free", [1, 2, 3])
def test_sweep_with_few_free_descriptors_keeps_a_live_run(place: Place, free: int) -> None:
    run = place.create()
    with only_free_descriptors(free):
        assert place.sweep() == Swept()
    assert len(place.names()) == 1
    run.remove()


def test_names_of_another_user_are_left_alone(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    place.add_names(RUN)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert place.sweep() == Swept()
    assert len(place.names()) == 1


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
def test_sweeps_do_not_affect_runs_that_start_and_end_meanwhile(place: Place, sweepers: list[Swept]) -> None:
    run_ids = set()
    for _ in range(100):
        run = place.create()
        assert len(place.names()) == 1
        assert [found.is_live for found in list_runs([place.base])] == [True]
        run.remove()
        run_ids.add(run.run_id)
    assert len(sweepers) > 2
    assert not any(run_ids & set(result.runs) for result in sweepers)
