"""The bindings of the hot path in C let go of every object that they held."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.bus.hot._support.build import HOT

PROGRAM = "tests.bus.hot._support.reference_counts"
PLANTED = {
    "a message too many": (
        "subscriber.c", "    Py_DECREF(message.bytes);\n", "", "exchanging", "blocks of memory"
    ),
    "None too often": (
        "endpoint_bindings.c", "lock_give(self->lock);\n    Py_XDECREF(result);", "lock_give(self->lock);",
        "routing", "references to None",
    ),
}  # fmt: skip
"""The file, its text, that with a defect, the play that shows it, and what gathers."""


def play(folder: Path, sources: Path, *plays: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", PROGRAM, folder, sources, *plays],
        capture_output=True, text=True, check=False, timeout=280,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_nothing_gathers(compiler_command: list[str], kept_builds: Path) -> None:
    assert compiler_command
    done = play(kept_builds, HOT)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    assert done.stdout.count("nothing gathers") == 5


@pytest.mark.sampled(1)
@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("defect", PLANTED)
def test_reference_too_many_is_noticed(defect: str, compiler_command: list[str], tmp_path: Path) -> None:
    assert compiler_command
    name, old, new, played, gathers = PLANTED[defect]
    sources = tmp_path / "hot"
    shutil.copytree(HOT, sources)
    text = (sources / name).read_text()
    assert text.count(old) == 1, f"{name} reads otherwise now; plant this defect again"
    (sources / name).write_text(text.replace(old, new))
    done = play(tmp_path, sources, played)
    assert done.returncode == 1 and gathers in done.stdout, done.stderr
