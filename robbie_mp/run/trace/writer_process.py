"""The process that writes a run's files: `python -m robbie_mp.run.trace.writer_process`.

A disk may stall for seconds, and a process that writes to it then sleeps in the kernel. The supervisor must
not sleep, so it sends all data to this process (`robbie_mp.run.trace.disk_writer`). Orders arrive on standard
input: a line of JSON, `[NAME, ARGUMENTS…, LENGTH]`, and LENGTH bytes. The process acknowledges each order on
standard output with one byte: 0 if it is done, or the number of the error (errno) with which the disk refused
it. At the end of its input, for example because the supervisor was killed, it has written everything it
received, and it ends.
"""

import errno
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

DONE = 0


class Writer:
    """Carries out orders; each method raises OSError if the disk refuses."""

    def __init__(self) -> None:
        self._folder = Path()
        self._bounds = (1 << 20, 1)
        self._files: dict[str, RotatingFile] = {}
        self._page: TracePage | None = None
        self._crashes: CrashFolder | None = None
        self._orders: dict[str, Callable[..., None]] = {
            "trace": self._open_trace,
            "entries": self._entries,
            "report": self._report,
            "replace": self._replace,
            "remove": self._remove,
        }

    def carry_out(self, order: list[str], data: bytes) -> int:
        """Carry out one order; return DONE, or the number of the error with which the disk refused it."""
        try:
            self._orders[order[0]](data, *order[1:])
        except OSError as error:
            return error.errno or errno.EIO
        return DONE

    def close(self) -> None:
        """Close all files."""
        for file in self._files.values():
            file.close()
        if self._page:
            self._page.close()

    def _open_trace(self, limits: bytes, folder: str, begin_page: str) -> None:
        bounds: dict[str, int] = json.loads(limits)
        self._folder = Path(folder)
        self._bounds = (bounds["file_bytes"], bounds["files"])
        self._page = TracePage(
            self._folder, bounds["page_bytes"], bounds["pages"], begin_anew=bool(begin_page)
        )
        self._crashes = CrashFolder(self._folder, bounds["crash_reports"])

    def _entries(self, data: bytes, module: str) -> None:
        if module not in self._files:
            self._files[module] = RotatingFile(self._folder / f"{module}.jsonl", *self._bounds)
        try:
            self._files[module].write(data)
        finally:
            if self._page:
                self._page.write(data.splitlines(keepends=True))

    def _report(self, data: bytes, module: str, name: str) -> None:
        if self._crashes is not None:
            self._crashes.keep(module, name, data)

    def _replace(self, data: bytes, path: str) -> None:
        write_private(Path(path), data)

    def _remove(self, _data: bytes, path: str) -> None:
        shutil.rmtree(path, ignore_errors=True)


def serve(orders: BinaryIO, answers: int) -> None:
    """Carry out all orders and acknowledge each."""
    writer = Writer()
    while line := orders.readline():
        *order, length = json.loads(line)
        data = orders.read(length)
        if len(data) < length:
            break  # the supervisor was killed while it sent the order
        answer = writer.carry_out(order, data)
        if answers >= 0:
            try:
                os.write(answers, bytes([min(answer, 255)]))
            except OSError:
                answers = -1  # the supervisor has ended
    writer.close()


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # A signal to the whole session or group must not lose the last entries.
        signal.signal(number, signal.SIG_IGN)
    serve(sys.stdin.buffer, sys.stdout.fileno())
