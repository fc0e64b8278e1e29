"""Rules of the sources in C that a reader must be able to rely on."""

import re
from pathlib import Path

import pytest

from robbie_mp.bus._hot.sources import sources_in
from tests.bus.hot._support.build import HOT, compile_c

SOURCES = sources_in(HOT)
BELOW_PYTHON = ("ring.c", "books.c", "router.c", "endpoint.c", "wakeup.c", "clock.c")
"""Sources that do not include Python.h, so that they run under sanitizers and fuzzers."""
OTHER_STORES = re.compile(
    r"\batomic_(?!thread_fence)\w+|\b__(atomic|sync)_|[.>]\s*atomic\b|\bvolatile\b|(?<!sizeof)\(\s*shared_word\s*\)|\basm\b"
)
TO_SHARED_WORDS = re.compile(r"[(<]\s*(const\s+)?shared_word\s*\*\s*[)>]")


def without_comments(path: Path) -> str:
    comment = r"/\*.*?\*/|//[^\n]*" if path.suffix in (".c", ".h") else r"#[^\n]*"
    return re.sub(comment, "", path.read_text(), flags=re.DOTALL)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_words_are_stored_in_one_place_only(path: Path) -> None:
    """Every store goes through `store` of words.h, or a test that stops before each store proves nothing."""
    code = without_comments(path)
    if path.name != "words.h":
        stores = [match[0] for match in OTHER_STORES.finditer(code)]
        # Several processes write the count of posts, as that of a semaphore; no step of the core rests on it.
        assert stores == (["atomic_fetch_add_explicit", ">atomic"] if path.name == "wakeup.c" else [])
        assert not TO_SHARED_WORDS.search(code), "only hold_words makes words of other memory"
    else:
        assert len(re.findall("atomic_store", code)) == len(re.findall("before_store", code)) - 2 == 1


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_single_argument_of_a_call_is_in_parentheses(path: Path) -> None:
    """With a format of "O" alone, a tuple is taken apart and its items become the arguments."""
    assert not re.findall(r'PyObject_Call(?:Method|Function)\([^;]*"[NOSU]"[^;]*;', without_comments(path))


@pytest.mark.parametrize("statement", ["*place = 1;", "place[1] = 1;", "*place += 1;", "(*place)++;"])
def test_assignment_to_a_word_does_not_compile(
    statement: str, compiler_command: list[str], tmp_path: Path
) -> None:
    source = tmp_path / "assignment.c"
    for body, is_right in ((statement, False), ("store(place, 1);", True)):
        source.write_text(f'#include "words.h"\nvoid assign(shared_word *place) {{ {body} }}\n')
        try:
            compile_c(compiler_command, tmp_path / "assignment.o", [source], "-c")
        except AssertionError:
            assert not is_right
        else:
            assert is_right


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_file_says_its_subject(path: Path) -> None:
    """At its beginning, or at the beginning of its header."""
    header = path.with_suffix(".h")
    assert path.read_text().startswith(("/* ", "# ")) or (
        header.exists() and header.read_text().startswith("/* ")
    )


@pytest.mark.parametrize("name", BELOW_PYTHON)
def test_lower_layer_knows_nothing_of_python(name: str, compiler_command: list[str], tmp_path: Path) -> None:
    listed = tmp_path / "included"
    compile_c(compiler_command, listed, [HOT / name], "-MM")
    included = set(re.findall(r"[\w.]+\.h", listed.read_text()))
    assert included
    for path in (HOT / each for each in (name, *included)):
        assert "Python.h" not in without_comments(path)
