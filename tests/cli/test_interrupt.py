"""Ctrl-C ends a command without a traceback, whenever it comes."""

import signal
import subprocess
import sys

import pytest

INTERRUPTED_AT_IMPORT = """
import os, signal, sys

class Interrupts:
    '''Sends what Ctrl-C sends when a module is about to be imported.'''

    def find_spec(self, name, path, target=None):
        if name == sys.argv[1]:
            print("pressed", flush=True)
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupts())
from robbie_mp.cli import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize("name", ["robbie_mp.cli.program", "rich", "robbie_mp.cli.run", "numpy", "yaml"])
def test_interrupt_during_imports_prints_nothing(name: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_AT_IMPORT, name, "run", "nosuch"],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (ended.stdout, ended.stderr) == ("pressed\n", "")
    assert ended.returncode in (-signal.SIGINT, 130)


def test_interrupt_of_a_command_is_exit_code_130() -> None:
    command = (
        "import os, signal, sys; from robbie_mp.cli import diff, main; "
        "diff.open_log = lambda *_: os.kill(os.getpid(), signal.SIGINT); "
        "sys.exit(main(['diff', 'a', 'b']))"
    )
    ended = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=False, timeout=60
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")
