"""The router and the rings in C stand any input, under AddressSanitizer and UndefinedBehaviorSanitizer.

`programs/fuzz_router.c` makes inputs at random, and checks the books after every step. Checks of the router
that are left out must be found, or it proves nothing. By hand, with clang's libFuzzer, which looks for inputs
that reach new branches:

    clang -std=c11 -g -O1 -fsanitize=fuzzer,address,undefined -DWITH_LIBFUZZER -Irobbie_mp/bus/_hot \\
        tests/bus/hot/programs/fuzz_router.c robbie_mp/bus/_hot/{router,books,ring}.c -o fuzz
    ./fuzz -max_len=2000
"""

import subprocess
from pathlib import Path

import pytest

from tests.bus.hot._support.build import HOT, PROGRAMS, compile_c

SOURCES = ("router.c", "books.c", "ring.c")
SANITIZERS = ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined")
INPUTS = 3_000
PLANTED = {
    "a message on a declaration beyond the table": ("declaration < DECLARATION_COUNT ?", "true ?"),
    "a message on no channel": ("channel == NULL || ", ""),
    "a message in another's name": ("(source & SOURCE_OF_INCARNATION) != link->source || ", ""),
    "a message without a free row": ("books->free_handles->count == 0 || ", ""),
    "references without free rows": (
        "books->free_references->count < channel->subscription_count", "books->free_references->count == 0",
    ),
    "an older message of a reference": (
        "load(reference_row(books, record[1]) + REFERENCE_SEQUENCE) == record[2]", "true",
    ),
    "done with what it does not have": (
        "if (!is_in(books, link->pushed, record))", "if (record[1] >= books->reference_count)",
    ),
    "more than the credit": (" || link->pushed->count >= link->credit", ""),
    "bytes in flight that are not counted": ("& SOURCE_SLOT] -= load(row", "& SOURCE_SLOT] -= 0 & load(row"),
    "a queue that drops nothing": ("slot->waiting->count > slot->queue_messages || ", ""),
    "a holder that is not counted": ("books->holders[handle]++;", ""),
    "a row that is not freed": (
        "books->free_references->rows[books->free_references->count++] = reference;", "",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def objects(compiler_command: list[str], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """All but the router, compiled."""
    folder, made = tmp_path_factory.mktemp("objects"), []
    for source in (PROGRAMS / "fuzz_router.c", *(HOT / name for name in SOURCES if name != "router.c")):
        made.append(folder / f"{source.stem}.o")
        compile_c(compiler_command, made[-1], [source], *SANITIZERS, "-c")
    return made


def build(command: list[str], objects: list[Path], router: str, folder: Path) -> Path:
    source, target = folder / "router.c", folder / "fuzz_router"
    source.write_text(router)
    compile_c(command, target, [source, *objects], *SANITIZERS)
    return target


def fuzz(program: Path, inputs: int, seed: int) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [program, str(inputs), str(seed)], capture_output=True, text=True, check=False, timeout=110
    )


@pytest.mark.slow
def test_router_stands_any_input(compiler_command: list[str], objects: list[Path], tmp_path: Path) -> None:
    program = build(compiler_command, objects, (HOT / "router.c").read_text(), tmp_path)
    done = fuzz(program, INPUTS, 1)
    assert (done.returncode, done.stderr) == (0, "")
    print(done.stdout)


@pytest.mark.sampled(4)
@pytest.mark.slow
@pytest.mark.parametrize("defect", PLANTED)
def test_check_that_is_missing_is_found(
    defect: str, compiler_command: list[str], objects: list[Path], tmp_path: Path
) -> None:
    old, new = PLANTED[defect]
    text = (HOT / "router.c").read_text()
    assert text.count(old) == 1, "router.c reads otherwise now; plant this defect again"
    program = build(compiler_command, objects, text.replace(old, new), tmp_path)
    assert fuzz(program, INPUTS, 1).returncode != 0
