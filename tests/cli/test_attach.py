"""`robbie attach` shows what a debugger says, however much that is. See also tests/run/test_breakpoints."""

import os
import socket
import sys
import threading
from pathlib import Path

import pytest

from robbie_mp.cli import attach
from robbie_mp.run.debug_link import DebugLink
from robbie_mp.run.supervisor.module_debugger import ModuleDebugger


def test_line_without_an_end_is_shown_in_pieces(capsys: pytest.CaptureFixture[str]) -> None:
    ours, theirs = map(DebugLink, socket.socketpair())
    piece, count = "x" * 8000, 20
    longest = attach.MAX_PROMPT + len(piece)

    def say() -> None:
        for _ in range(count):
            theirs.send({"text": piece})
        theirs.close()

    said: list[int] = []
    show = sys.stdout.write

    def write(text: str) -> int:
        said.append(len(text))
        return show(text)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys.stdout, "write", write)
        saying = threading.Thread(target=say)
        saying.start()
        attach._debug(ours)
        saying.join()
    ours.close()
    assert capsys.readouterr().out == piece * count
    assert max(said) <= longest


def test_file_of_the_current_folder_is_not_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a folder such as /tmp, another user may have written it."""
    (tmp_path / ".pdbrc").write_text("!__import__('os').mkdir('executed')\n")
    monkeypatch.chdir(tmp_path)
    debugger = ModuleDebugger(tmp_path, threading.RLock(), lambda: None)
    assert not debugger.rcLines
    assert os.listdir(tmp_path) == [".pdbrc"]
