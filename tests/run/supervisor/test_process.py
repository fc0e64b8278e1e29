"""One child process, without a tree."""

import errno
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robbie_mp.run.supervisor.process import ChildProcess, ExitStatus
from tests._support.few_descriptors import only_free_descriptors
from tests._support.places import PROJECT
from tests.run.supervisor._support.running import is_gone, wait_for


@contextmanager
def started(code: str, **environment: str) -> Iterator[ChildProcess]:
    process = ChildProcess.start(
        (sys.executable, "-S", "-c", code), {"PYTHONPATH": str(PROJECT), **environment}, "run/child/1"
    )
    try:
        yield process
    finally:
        process.kill()
        ended(process)
        process.reap()
        os.close(process.stdout)
        os.close(process.stderr)
        os.close(process.log_channel)


def ended(process: ChildProcess) -> ExitStatus:
    assert select.select([process.pidfd], [], [], 10.0)[0], "it does not end"
    status = process.exit_status()
    assert status
    return status


def output(process: ChildProcess) -> str:
    ended(process)
    return os.read(process.stdout, 65536).decode()


@pytest.mark.parametrize(
    ("code", "reason", "is_clean"),
    [
        ("pass", "exit code 0", True),
        ("raise SystemExit(7)", "exit code 7", False),
        ("import os; os.kill(os.getpid(), 11)", "killed by SIGSEGV", False),
        ("import os; os.abort()", "killed by SIGABRT", False),
        ("import os; os.kill(os.getpid(), 40)", "killed by signal 40", False),
    ],
)
def test_every_kind_of_end_is_described(code: str, reason: str, is_clean: bool) -> None:
    with started(code) as process:
        status = ended(process)
        assert (status.reason, status.is_clean) == (reason, is_clean)
        assert process.exit_status() == status, "asking did not reap it"


def test_child_that_has_just_ended_is_not_stopped() -> None:
    with started("pass") as process:
        ended(process)
        assert not process.is_stopped


def test_child_leads_a_separate_session() -> None:
    with started("import os; print(os.getsid(0), os.getpgid(0))") as process:
        assert output(process).split() == [str(process.pid)] * 2


def test_child_inherits_only_the_descriptor_of_its_log_channel() -> None:
    reader, writer = os.pipe()
    os.set_inheritable(writer, True)
    try:
        with started(
            "import os, sys; channel = os.environ['ROBBIE_LOG_CHANNEL']; "
            "print(sorted({*os.listdir('/proc/self/fd')} - {channel}, key=int)[:-1], sys.stdin.read())"
        ) as process:
            assert output(process).strip() == "['0', '1', '2']"
    finally:
        os.close(reader)
        os.close(writer)


def test_child_gets_only_the_given_environment_and_our_two_variables() -> None:
    with started("import os; print(sorted(set(os.environ) - {'LC_CTYPE'}))", ROBOT="lisa") as process:
        assert output(process).strip() == "['PYTHONPATH', 'ROBBIE_CHILD', 'ROBBIE_LOG_CHANNEL', 'ROBOT']"


def test_command_that_does_not_exist_leaves_nothing_open() -> None:
    with pytest.raises(FileNotFoundError):
        ChildProcess.start(("/no/such/command",), {}, "run/child/1")


@pytest.mark.parametrize("free", range(13))
def test_start_without_free_descriptors_leaves_neither_descriptor_nor_process(free: int) -> None:
    """Wherever they run out: at a pipe, within Popen, or at the pidfd of a process that runs already."""
    before = sorted(os.listdir("/proc/self/fd"))
    with only_free_descriptors(free):
        try:
            process = ChildProcess.start(("/bin/sleep", "60"), {}, "run/child/1")
        except OSError as error:
            assert error.errno == errno.EMFILE
            process = None
    if process is None:
        assert sorted(os.listdir("/proc/self/fd")) == before
        with pytest.raises(ChildProcessError):
            os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG)
        assert free < 12, "with that many it starts"
        return
    process.kill()
    ended(process)
    process.reap()
    for fd in (process.stdout, process.stderr, process.log_channel):
        os.close(fd)


def test_child_whose_process_cannot_be_watched_is_killed_and_reaped(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_pid: int) -> int:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    before = sorted(os.listdir("/proc/self/fd"))
    monkeypatch.setattr(os, "pidfd_open", refuse)
    with pytest.raises(OSError, match="Too many open files"):
        ChildProcess.start(("/bin/sleep", "60"), {}, "run/child/1")
    assert sorted(os.listdir("/proc/self/fd")) == before
    with pytest.raises(ChildProcessError):
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG)


def test_child_dies_if_its_parent_died_before_the_death_signal_was_set() -> None:
    """The child is told a parent that is not its parent (any more)."""
    code = "from robbie_mp.base.linux.prctl import die_with_parent; die_with_parent(1); print('lives')"
    with started(code) as process:
        assert ended(process).signal == signal.SIGKILL


def test_child_dies_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    child = "import os, signal; die_with_parent(os.getppid()); print(os.getpid(), flush=True); signal.pause()"
    parent = f"""if True:
        import os, signal
        from robbie_mp.base.linux.prctl import die_with_parent
        if os.fork() == 0:
            {child}
        signal.pause()
    """
    command = [sys.executable, "-S", "-c", parent]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={"PYTHONPATH": str(PROJECT)}
    ) as process:
        assert process.stdout
        pid = int(process.stdout.readline())
        process.kill()
        wait_for(lambda: is_gone(pid), limit_s=1.0)
