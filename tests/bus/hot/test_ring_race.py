"""Two threads use the rings in C, and ThreadSanitizer looks for memory that their fences do not protect.

ThreadSanitizer knows no fences; `programs/tsan_words.h` says how they are shown to it. So that this proves
something, each fence of ring.c is left out in turn, and must be missed.
"""

import os
import re
import subprocess
from pathlib import Path

import pytest

from tests.bus.hot._support.build import HOT, PROGRAMS, compile_c

PAIRS = ("records", "numbers", "blocks")
RECORDS = 10_000
MANY_RECORDS = 100_000
RACE_EXIT = 66
RING = (HOT / "ring.c").read_text()
FENCES = [match.start() for match in re.finditer(r"\bfence\w*\(\);", RING)]


@pytest.fixture(scope="module")
def fences(compiler_command: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The fences for ThreadSanitizer, compiled without it."""
    target = tmp_path_factory.mktemp("fences") / "tsan_words.o"
    compile_c(compiler_command, target, [PROGRAMS / "tsan_words.c"], "-O2", "-c")
    return target


def build(command: list[str], fences: Path, ring: str, folder: Path) -> Path:
    source, target = folder / "ring.c", folder / "ring_race"
    source.write_text(ring)
    options = ["-O2", "-Wall", "-Werror", "-fsanitize=thread", "-include", str(PROGRAMS / "tsan_words.h")]
    compile_c(command, target, [PROGRAMS / "ring_race.c", source, fences], *options)
    return target


def race(program: Path, pair: str, records: int) -> "subprocess.CompletedProcess[str]":
    environment = os.environ | {"TSAN_OPTIONS": f"halt_on_error=1:exitcode={RACE_EXIT}"}
    return subprocess.run(
        [program, pair, str(records)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )


def check_rings(program: Path, records: int) -> None:
    for pair in PAIRS:
        done = race(program, pair, records)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout == f"{pair}: {records} records\n"


@pytest.mark.slow
@pytest.mark.every_turn
def test_rings_protect_memory_by_their_fences_alone(
    compiler_command: list[str], fences: Path, tmp_path: Path
) -> None:
    program = build(compiler_command, fences, RING, tmp_path)
    check_rings(program, RECORDS)


@pytest.mark.slow
def test_rings_protect_memory_of_many_records(
    compiler_command: list[str], fences: Path, tmp_path: Path
) -> None:
    program = build(compiler_command, fences, RING, tmp_path)
    check_rings(program, MANY_RECORDS)


@pytest.mark.sampled(3)
@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(FENCES)))
def test_missing_fence_is_noticed(
    number: int, compiler_command: list[str], fences: Path, tmp_path: Path
) -> None:
    at = FENCES[number]
    program = build(
        compiler_command, fences, RING[:at] + re.sub(r"^\w+\(\)", "", RING[at:], count=1), tmp_path
    )
    done = [race(program, pair, RECORDS) for pair in PAIRS]
    assert RACE_EXIT in [one.returncode for one in done], f"nobody missed the fence in {RING[:at][-200:]}"
