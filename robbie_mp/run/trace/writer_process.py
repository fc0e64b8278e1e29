"""The process that writes a run's files: `python -m robbie_mp.run.trace.writer_process`.

A disk may stall for seconds, and a process that writes to it then sleeps in the kernel. The supervisor must
not sleep, so it sends all data to this process (`robbie_mp.run.trace.disk_writer`). Orders arrive on standard
input: a line of JSON, `[NAME, ARGUMENTS…, LENGTH]`, and LENGTH bytes. The process acknowledges each order on
standard output with one byte: `1` if it is done, `0` if the disk refused it. At the end of its input, for
example because the supervisor was killed, it has written everything it received, and it ends.
"""

import json
import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from robbie_mp.base.linux.private_files import write_private
from robbie_mp.run.trace.crash import CrashFolder
from robbie_mp.run.trace.page import TracePage
from robbie_mp.run.trace.rotating_file import RotatingFile

DONE = b"1"
REFUSED = b"0"


class Writer:
    """Carries out orders; each method returns whether the disk accepted it."""

    def __init__(self) -> None:
        self._folder = Path()
        self._bounds = (1 << 20, 1)
        self._files: dict[str, RotatingFile] = {}
        self._page: TracePage | None = None
        self._crashes: CrashFolder | None = None
        self._orders: dict[str, Callable[..., bool]] = {
            "trace": self._open_trace,
            "entries": self._entries,
            "report": self._report,
            "replace": self._replace,
            "remove": self._remove,
        }

    def carry_out(self, order: list[str], data: bytes) -> bool:
        """Carry out one order; return False if the disk refused it."""
        try:
            return self._orders[order[0]](data, *order[1:])
        except OSError:
            return False

    def close(self) -> None:
        """Close all files."""
        for file in self._files.values():
            file.close()
        if self._page:
            self._page.close()

    def _open_trace(self, limits: bytes, folder: str, begin_page: str) -> bool:
        bounds: dict[str, int] = json.loads(limits)
        self._folder = Path(folder)
        self._bounds = (bounds["file_bytes"], bounds["files"])
        self._page = TracePage(
            self._folder, bounds["page_bytes"], bounds["pages"], begin_anew=bool(begin_page)
        )
        self._crashes = CrashFolder(self._folder, bounds["crash_reports"])
        return True

    def _entries(self, data: bytes, module: str) -> bool:
        if module not in self._files:
            self._files[module] = RotatingFile(self._folder / f"{module}.jsonl", *self._bounds)
        is_written = self._files[module].write(data)
        if self._page:
            self._page.write(data.splitlines(keepends=True))
        return is_written

    def _report(self, data: bytes, module: str, name: str) -> bool:
        return self._crashes is not None and self._crashes.keep(module, name, data)

    def _replace(self, data: bytes, path: str) -> bool:
        write_private(Path(path), data)
        return True

    def _remove(self, _data: bytes, path: str) -> bool:
        shutil.rmtree(path, ignore_errors=True)
        return not os.path.lexists(path)


def serve(orders: BinaryIO, answers: int) -> None:
    """Carry out all orders and acknowledge each."""
    writer = Writer()
    while line := orders.readline():
        *order, length = json.loads(line)
        data = orders.read(length)
        if len(data) < length:
            break  # the supervisor was killed while it sent the order
        answer = DONE if writer.carry_out(order, data) else REFUSED
        if answers >= 0:
            try:
                os.write(answers, answer)
            except OSError:
                answers = -1  # the supervisor has ended
    writer.close()


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # A signal to the whole session or group must not lose the last entries.
        signal.signal(number, signal.SIG_IGN)
    serve(sys.stdin.buffer, sys.stdout.fileno())
