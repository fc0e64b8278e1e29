"""Every program of `tools/` starts, and says with `--help` what it does instead of doing it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.trials.__main__ import subjects

ROOT = Path(__file__).parents[1]
START_ALL = """\
import contextlib, io, runpy, sys, traceback

for name in sys.argv[1:]:
    name, *words = name.split()
    sys.argv = [name, *words, "--help"]
    for imported in (name, f"{name}.__main__"):  # perhaps by another program
        sys.modules.pop(imported, None)
    shown = io.StringIO()
    try:
        with contextlib.redirect_stdout(shown):
            runpy.run_module(name, run_name="__main__", alter_sys=True)
    except SystemExit as end:
        if end.code or "usage: " not in shown.getvalue():
            print(f"{name} {words} ended with {end.code!r} and showed {shown.getvalue()!r}")
    except Exception:
        print(f"{name}: {traceback.format_exc()}")
    else:
        print(f"{name} did something in spite of --help")
"""


def _files() -> list[Path]:
    """Return the files that may be programs; those of other rooms are parts of their package."""
    own = [*(ROOT / "tools").glob("**/__main__.py")]
    own += [
        path for room in ("", "docs", "operator", "pictures") for path in (ROOT / "tools" / room).glob("*.py")
    ]
    parts = ("kill_campaign/soak", "link/campaign", "link/trial")
    return own + [ROOT / "tools" / f"{part}.py" for part in parts]


def programs() -> list[str]:
    """Return the programs that can be started by themselves, and each subject of trials."""
    files = [path for path in _files() if '__name__ == "__main__"' in path.read_text()]
    dotted = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files]
    names = {name.removesuffix(".__main__") for name in dotted}
    return sorted(names | {f"tools.trials {name}" for name in subjects()})


@pytest.mark.slow
def test_every_tool_starts_and_explains_itself(tmp_path: Path) -> None:
    names = programs()
    assert {"tools.trials rescue", "tools.pictures.top", "tools.bench"} <= set(names)
    found = subprocess.run(
        [sys.executable, "-W", "error", "-c", START_ALL, *names],
        cwd=tmp_path,  # one that ignores --help does not overwrite a picture of the docs
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (found.returncode, found.stdout, found.stderr) == (0, "", "")
