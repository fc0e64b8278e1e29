"""Processes have descriptors, whether this Python was built with the headers for that or not."""

import contextlib
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from robbie_mp.base.linux.pidfd import P_PIDFD, open_process, send_signal

LACKS = "import os, signal; del os.pidfd_open, os.P_PIDFD, signal.pidfd_send_signal; "
"""As in the interpreters that uv downloads."""


@pytest.fixture(params=["Python has it", "the system call"])
def either_way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "the system call":
        monkeypatch.delattr(os, "pidfd_open", raising=False)
        monkeypatch.delattr(signal, "pidfd_send_signal", raising=False)


@contextlib.contextmanager
def sleeping() -> Iterator["subprocess.Popen[bytes]"]:
    with subprocess.Popen(("/bin/sleep", "60")) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.usefixtures("either_way")
def test_signal_by_descriptor_ends_the_process_and_makes_it_readable() -> None:
    with sleeping() as process:
        pidfd = open_process(process.pid)
        try:
            assert not os.get_inheritable(pidfd)
            assert not select.select([pidfd], [], [], 0)[0]
            send_signal(pidfd, signal.SIGTERM)
            assert select.select([pidfd], [], [], 10)[0], "it does not end"
            ended = os.waitid(P_PIDFD, pidfd, os.WEXITED | os.WNOWAIT)
            assert ended is not None and ended.si_status == signal.SIGTERM
            process.wait()
            with pytest.raises(ProcessLookupError):
                send_signal(pidfd, signal.SIGTERM)
        finally:
            os.close(pidfd)


@pytest.mark.usefixtures("either_way")
def test_process_that_has_ended_has_no_descriptor() -> None:
    with sleeping() as process:
        process.kill()
        process.wait()
        with pytest.raises(ProcessLookupError):
            open_process(process.pid)


def test_python_without_them_has_the_number_of_waitid() -> None:
    code = LACKS + "from robbie_mp.base.linux.pidfd import P_PIDFD; print(P_PIDFD)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(said.stdout) == os.P_PIDFD
