"""What a replay gives a module that is not of Robbie-MP, and what it names."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from robbie_mp.logs.capsule.outside import Outside, TimeOfThen
from robbie_mp.logs.capsule.variables import named_variables

CODE = """
import os
import random
import socket
import subprocess
import threading
import uuid
from datetime import datetime
from pathlib import Path


def act():
    {act}
"""
WATCHED = """
import sys
from pathlib import Path

from robbie_mp.logs.capsule.outside import Outside

outside = Outside(Path.cwd())
outside.watch()
sys.path.insert(0, ".")
import code_of_user

code_of_user.act()
print("; ".join(outside.noted))
"""


@pytest.mark.parametrize(
    ("act", "noted"),
    [
        ("random.random()", ""),
        ("uuid.uuid4()", "chance without a seed"),
        ("random.Random().random()", "chance without a seed"),
        ("random.Random(3).random()", ""),
        ("Path('speed.txt').exists()", "the file speed.txt"),
        ("open('/dev/null').close()", ""),
        ("threading.Thread(target=dict).start()", "a thread of its own"),
        ("subprocess.run(['true'])", "another program"),
        ("socket.socket(type=socket.SOCK_DGRAM).connect(('127.0.0.1', 9))", "a socket of its own"),
        ("datetime.now()", "datetime.now()"),
    ],
)
def test_what_code_takes_from_outside_is_named_with_its_line(act: str, noted: str, tmp_path: Path) -> None:
    (tmp_path / "code_of_user.py").write_text(CODE.format(act=act))
    run = subprocess.run(
        [sys.executable, "-c", WATCHED], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert run.stdout.splitlines()[-1] == (f"{noted} (code_of_user.py:13)" if noted else "")


def test_clocks_of_python_say_the_time_of_then_and_do_not_go_back(tmp_path: Path) -> None:
    then = TimeOfThen(epoch_ns=1_000_000_000_000, begin_ns=5_000_000_000)
    with then.given(Outside(tmp_path)):
        assert 5 <= time.monotonic() <= time.perf_counter() < 60
        assert 1005 <= time.time() < 1060
        then.begin(70_000_000_000)
        seen = time.monotonic_ns()
        assert seen >= 70_000_000_000
        then.begin(60_000_000_000)
        assert time.monotonic_ns() >= seen
    assert time.time() > 1_000_000


def test_variables_that_code_names_are_kept_but_no_secrets_and_none_that_decide_what_runs(
    tmp_path: Path,
) -> None:
    names = ["ARENA", "LD_PRELOAD", "PYTHONPATH", "PATH", "API_KEY", "ROBOT_PASSWORD", "HOME"]
    (tmp_path / "a.py").write_text(" ".join(names))
    environment = {name: "1" for name in [*names, "OTHER"]}
    assert named_variables([tmp_path / "a.py", tmp_path / "gone.py"], environment) == {"ARENA": "1"}
