"""The core ends at once, and writes nowhere, if an index in its own table is damaged.

Only the core writes that table, so this takes a fault of its code or of the machine's memory. The program is
built with AddressSanitizer, which would report a wrong access.
"""

import signal
import subprocess
from pathlib import Path

import pytest

from tests.bus.hot._support.build import HOT, PROGRAMS, compile_c

SANITIZERS = ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined")


@pytest.fixture(scope="module")
def program(compiler_command: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("damaged") / "damaged_rows"
    sources = [PROGRAMS / "damaged_rows.c", *(HOT / name for name in ("router.c", "books.c", "ring.c"))]
    compile_c(compiler_command, target, sources, *SANITIZERS)
    return target


def release(program: Path, *damage: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([program, *damage], capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.slow
@pytest.mark.parametrize("column", ["handle", "subscription"])
@pytest.mark.parametrize("index", ["100000", "0x100000000", "0xffffffffffffffff"])
def test_index_beyond_its_table_ends_the_core_before_it_is_used(
    program: Path, column: str, index: str
) -> None:
    done = release(program, column, index)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGABRT, "", "")


@pytest.mark.slow
@pytest.mark.every_turn
def test_row_without_a_subscription_ends_the_core(program: Path) -> None:
    done = release(program, "subscription", "1")
    assert (done.returncode, done.stderr) == (-signal.SIGABRT, "")


@pytest.mark.parametrize("column", ["handle", "subscription"])
def test_index_that_is_right_is_used(program: Path, column: str) -> None:
    done = release(program, column, "0")
    assert (done.returncode, done.stdout, done.stderr) == (0, "1 handled\n", "")
