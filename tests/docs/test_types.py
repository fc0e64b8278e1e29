"""Type checkers find nothing in the code of the pages, of the tutorial's workspace, and of a new workspace.

mypy is strict; pyright has the mode of editors, which is "standard".
"""

import ast
import builtins
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from robbie_mp.cli import main
from tests.docs._support.pages import PAGES, ROOT, blocks
from tests.docs.test_tutorial import Reader

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

FILES = ("append to ", "file ", "replace ", "change ")
"""Steps of a tutorial that write code."""


def names_made(code: ast.Module) -> set[str]:
    """The names that a block of code defines at its top level."""
    made: set[str] = set()
    for node in code.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            made.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            made |= {(alias.asname or alias.name).partition(".")[0] for alias in node.names}
        else:
            stored = [one for one in ast.walk(node) if isinstance(one, ast.Name)]
            made |= {one.id for one in stored if isinstance(one.ctx, ast.Store)}
    return made


def names_used(code: ast.Module) -> set[str]:
    """All names that a block of code needs from outside."""
    nodes = [node for node in ast.walk(code) if isinstance(node, ast.Name)]
    stored = {node.id for node in nodes if isinstance(node.ctx, ast.Store)}
    parameters = {node.arg for node in ast.walk(code) if isinstance(node, ast.arg)}
    return {node.id for node in nodes} - stored - parameters - names_made(code) - set(dir(builtins))


def imports_of_earlier(codes: list[ast.Module], index: int, name: str) -> str:
    """Import what a block of a page uses from the last blocks before it that define it."""
    lines = []
    for used in sorted(names_used(codes[index])):
        for earlier in reversed(range(index)):
            if used in names_made(codes[earlier]):
                lines.append(f"from {name}_{earlier} import {used}\n")
                break
    return "".join(lines)


def write_page(page: Path, folder: Path) -> int:
    """Write each block of a page as a program, and return how many there are."""
    shown = str(page.relative_to(ROOT))
    name = re.sub(r"\W", "_", shown.removesuffix(".md"))
    texts = [
        entry.text
        for entry in blocks(shown)
        if entry.language == "python" and not entry.text.startswith(" ")  # the body of a class
    ]
    codes = [ast.parse(text) for text in texts]
    for index, text in enumerate(texts):
        (folder / f"{name}_{index}.py").write_text(imports_of_earlier(codes, index, name) + text)
    return len(texts)


def write_tutorial(page: str, folder: Path) -> None:
    """Write the workspace that a reader of a tutorial has at its end."""
    reader = Reader(folder)
    for step in blocks(page):
        if step.mark.removeprefix("test: ").startswith(FILES):
            reader.do(step)


@pytest.fixture(scope="module")
def code(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("code")
    tutorials = {"docs/tutorial.md": "load", "docs/camera-robot.md": "camera"}
    written = sum(write_page(page, folder) for page in PAGES if str(page.relative_to(ROOT)) not in tutorials)
    assert written > 25
    for page, name in tutorials.items():
        assert main(["new", str(folder / name)]) == 0
        write_tutorial(page, folder / name)
    assert main(["new", str(folder / "new")]) == 0
    return folder


PLACES = ("", "load", "camera", "new")
"""Folders with code: that of the pages, and workspaces."""


def files_in(place: Path) -> list[str]:
    """The files to check: a page's folder has the workspaces below it."""
    if (place / "profiles").exists():
        return sorted(str(file.relative_to(place)) for file in place.glob("**/*.py"))
    return sorted(file.name for file in place.glob("*.py") if "robbie_mp" in file.read_text())


def test_mypy_finds_nothing_in_strict_mode(code: Path) -> None:
    command = [sys.executable, "-m", "mypy", "--strict", "--ignore-missing-imports", "--implicit-reexport"]
    for place in map(code.joinpath, PLACES):
        done = subprocess.run(
            [*command, "--config-file=", "--cache-dir", str(code / "cache"), *files_in(place)],
            cwd=place,
            env=os.environ | {"MYPYPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", PLACES)
def test_pyright_finds_nothing_in_standard_mode(code: Path, name: str) -> None:
    pytest.importorskip("pyright")
    place = code / name
    settings = {
        "typeCheckingMode": "standard",
        "include": files_in(place),
        "extraPaths": [str(ROOT)],
        "reportMissingImports": False,  # devices of readers
        "reportMissingModuleSource": False,
    }
    (place / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "-p", str(place)]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
