"""A release that comes while the core falls asleep is never missed, in whatever order the two act.

A module pushes a release and then reads whether the core wants to be woken; the core writes that it does, and
then looks at the ring once more. `programs/release_race.c` runs this code of both in every order, with stores
that are seen late. Each fence, the request and the second look are left out in turn, and must be missed.
"""

import re
import subprocess
from pathlib import Path

import pytest

from tests.bus.hot._support.build import HOT, PROGRAMS, compile_c

MISSED = 66
SOURCES = ("ring.c", "books.c", "router.c", "endpoint.c")
IN_ENDPOINT = """\
    fence();
    const uint64_t wanted"""
IN_ROUTER = """\
    if (look_again)
        fence();"""
REQUEST = "store(link->inbound->place.head + (IN_WANT_RELEASE - IN_HEAD), want);"
LEFT_OUT = {
    "the module's fence": ("endpoint.c", IN_ENDPOINT, IN_ENDPOINT.replace("fence();", "")),
    "the module's look": (
        "endpoint.c",
        "wanted != 0 && endpoint->inbound->tail >= wanted",
        "wanted == 0 && 0",
    ),
    "the core's fence": ("router.c", IN_ROUTER, IN_ROUTER.replace("fence();", "{}")),
    "the core's second look": ("router.c", "    return look_again;", "    return false;"),
    "the core's request": ("router.c", REQUEST, ""),
}


def race(
    command: list[str], folder: Path, changed: tuple[str, str, str] | None = None
) -> "subprocess.CompletedProcess[str]":
    """Build the program, with one source changed, and run it."""
    sources = [PROGRAMS / "release_race.c", *(HOT / name for name in SOURCES)]
    if changed is not None:
        name, old, new = changed
        text = (HOT / name).read_text()
        assert text.count(old) == 1, f"{name} has changed: {old!r} is not in it once"
        (folder / name).write_text(text.replace(old, new))
        sources = [folder / name if source.name == name else source for source in sources]
    target = folder / "release_race"
    compile_c(command, target, sources, "-O1", "-Wall", "-include", str(PROGRAMS / "tso_words.h"))
    return subprocess.run([target], capture_output=True, text=True, check=False, timeout=60)


def test_release_that_comes_while_the_core_falls_asleep_is_noticed_in_every_order(
    compiler_command: list[str], tmp_path: Path
) -> None:
    done = race(compiler_command, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    found = re.fullmatch(r"(\d+) orders, (\d+) posted, (\d+) seen\n", done.stdout)
    assert found is not None
    orders, posted, seen = map(int, found.groups())
    assert orders > 20
    assert 0 < posted < orders and 0 < seen < orders, "each of them is needed in some order"


@pytest.mark.parametrize("what", LEFT_OUT)
def test_part_of_the_handshake_that_is_left_out_is_missed(
    what: str, compiler_command: list[str], tmp_path: Path
) -> None:
    done = race(compiler_command, tmp_path, LEFT_OUT[what])
    assert done.returncode == MISSED, done.stdout
