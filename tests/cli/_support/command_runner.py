"""Runs commands of `robbie` in places that harm them; a program of its own, which forks for each command.

Reads cases as JSON from its input and writes what each command did. So the commands are imported once.
"""

import json
import os
import signal
import sys
import time
from tempfile import TemporaryFile, mkdtemp
from typing import IO, Any, NoReturn

from robbie_mp.cli import main
from robbie_mp.cli.program import parser_of
from tests._support.own_runs import see_own_runs_only

AT_A_TIME = 6
END_S = 20.0
"""A command that was told to end has so long for it."""


class Running:
    """A command that runs."""

    def __init__(self, case: dict[str, Any]):
        self.case = case
        self.output = TemporaryFile("w+")  # noqa: SIM115 - closed with the result
        self.errors = TemporaryFile("w+")  # noqa: SIM115
        self.began_s, self.is_told = time.monotonic(), False
        self.pid = os.fork()
        if not self.pid:
            be_command(case, self.output, self.errors)

    def result(self) -> dict[str, Any] | None:
        """Return what the command did, once it has ended; tell it to end after its time, as by Ctrl-C."""
        found, status = os.waitpid(self.pid, os.WNOHANG)
        if found:
            return {"code": os.waitstatus_to_exitcode(status), "told": self.is_told, **self._texts()}
        passed_s = time.monotonic() - self.began_s
        if passed_s > self.case["patience_s"] and not self.is_told:
            self.is_told = True
            os.kill(self.pid, signal.SIGINT)
        if passed_s > self.case["patience_s"] + END_S:
            os.kill(self.pid, signal.SIGKILL)
        return None

    def _texts(self) -> dict[str, str]:
        texts = {}
        for name, file in (("output", self.output), ("errors", self.errors)):
            file.seek(0)
            texts[name] = file.read(10_000)
            file.close()
        return texts


def results(cases: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Run commands, some at a time; return what each did."""
    waiting = list(enumerate(cases))
    running: dict[int, Running] = {}
    found: dict[int, dict[str, Any]] = {}
    while waiting or running:
        while waiting and len(running) < AT_A_TIME:
            number, case = waiting.pop(0)
            running[number] = Running(case)
        for number, one in list(running.items()):
            if (result := one.result()) is not None:
                found[number] = result
                del running[number]
        time.sleep(0.005)
    return [found[number] for number in range(len(cases))]


def be_command(case: dict[str, Any], output: IO[str], errors: IO[str]) -> NoReturn:
    """Become the command, in its place."""
    os.setsid()
    os.environ["XDG_RUNTIME_DIR"] = mkdtemp(dir=os.environ["XDG_RUNTIME_DIR"])  # sees no run of the others
    if case["gone"]:
        gone = mkdtemp(dir=case["folder"])
        os.chdir(gone)
        os.rmdir(gone)
    else:
        os.chdir(case["folder"])
    for name, value in case["environment"].items():
        os.environ.pop(name, None) if value is None else os.environ.update({name: value})
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(errors.fileno(), 2)
    take_output(case["output"], output)
    sys.exit(main(case["command"]))


def take_output(kind: str, output: IO[str]) -> None:
    """Make standard output what the case says."""
    if kind == "closed":
        os.close(1)
        sys.stdout = None  # as Python does if it starts so
        return
    if kind == "broken":
        reader, writer = os.pipe()
        os.close(reader)
    else:
        writer = os.open("/dev/full", os.O_WRONLY) if kind == "full" else output.fileno()
    os.dup2(writer, 1)


if __name__ == "__main__":
    see_own_runs_only()
    parser_of(())  # imports all commands
    json.dump(results(json.load(sys.stdin)), sys.stdout)
