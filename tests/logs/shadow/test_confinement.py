"""A shadow reaches no device, file, network or other process of the robot."""

import subprocess
import sys
from pathlib import Path

import pytest

REFUSED = {
    "open('/dev/ttyUSB0')": "must not open /dev/ttyUSB0",
    "open('/dev/shm/robbie', 'wb')": "must not open /dev/shm/robbie",
    "open('elsewhere', 'w')": "must not write",
    "os.open('elsewhere', os.O_CREAT | os.O_WRONLY)": "must not write",
    "os.remove('elsewhere')": "must not change",
    "os.rename(folder + '/a', 'elsewhere')": "must not change",
    "socket.socket().bind(('127.0.0.1', 0))": "the network",
    "socket.socket(type=socket.SOCK_DGRAM).sendto(b'x', ('127.0.0.1', 9))": "the network",
    "os.system('true')": "other programs",
    "os.fork()": "other processes",
    "os.kill(os.getppid(), 0)": "other processes",
    "signal.pidfd_send_signal(os.pidfd_open(os.getppid()), 0)": "other processes",
    "multiprocessing.get_context('spawn').Process(target=print).start()": "other programs",
    "shared_memory.SharedMemory('robbie-shadow-test', create=True, size=1)": "shared memory",
    "sqlite3.connect('elsewhere')": "must not change",
    "os.mkfifo('elsewhere')": "pipes",
    "os.setxattr('elsewhere', 'user.a', b'1')": "must not change",
}
ALLOWED = [
    "open(folder + '/map.png', 'w').close()",
    "os.mkdir(folder + '/maps')",
    "open('/dev/null', 'w').close()",
    "open('/proc/self/stat').close()",
    "sqlite3.connect(':memory:').close()",
    "sqlite3.connect(folder + '/found.db').close()",
    "multiprocessing.dummy.Pool(2).map(abs, [1])",
]


def outcome(folder: Path, code: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process that is confined to a folder."""
    begin = (
        "import multiprocessing.dummy, os, signal, socket, sqlite3; "
        "from multiprocessing import shared_memory; "
        f"from robbie_mp.logs.shadow.confinement import confine; folder = {str(folder)!r}"
    )
    program = f"{begin}; confine(folder); {code}"
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("code", REFUSED)
def test_what_belongs_to_the_robot_is_refused(tmp_path: Path, code: str) -> None:
    ended = outcome(tmp_path, code)
    assert ended.returncode == 1
    assert "NotForAShadow" in ended.stderr
    assert REFUSED[code] in ended.stderr
    assert not list(tmp_path.iterdir())


def test_its_own_results_are_allowed(tmp_path: Path) -> None:
    ended = outcome(tmp_path, "; ".join(ALLOWED))
    assert ended.returncode == 0, ended.stderr
