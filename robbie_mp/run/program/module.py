"""A program of a profile: any executable, supervised as a module is."""

import os
import shutil
import signal
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.fastdds_memory import remove_dead_participants
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.module import MessageHandling, Module, setting
from robbie_mp.module.settings import REQUIRED, SettingError
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.model import ModuleSpec
from robbie_mp.run.program.guarded_process import GuardedProcess, LineWatch, outcome
from robbie_mp.run.run_directory import list_runs
from robbie_mp.run.trace.channel import CHANNEL_VARIABLE

STOP_SIGNALS = ("SIGTERM", "SIGINT", "SIGHUP", "SIGQUIT")
GRACE_SHARE = 0.8
"""How much of `stop_grace_s` the program has; the rest is for killing its tree."""
CONNECT_LIMIT_S = 0.2
LOOK_S = 1.0
"""Time between two updates of the status, and between two calls at the port."""
POLL_S = 0.02


class ProgramSilent(RobbieError, RuntimeError):
    """A program gives no sign of life, so it is ended, and its restart policy decides what follows.

    Example scenarios:
      - a driver runs, but its device is gone, and it publishes nothing
      - a server hangs, and its port does not answer
    """


class Program(Module):
    """Runs a program, and ends with it; see docs/programs.md.

    velodyne:
      program: [ros2, run, velodyne_driver, velodyne_driver_node]
      settings: {alive_topic: PointCloud2 velodyne, within_s: 2}
    """

    period_s = 0.05
    follows_run_clock = False

    command: list[str] = setting(REQUIRED, "the program and its arguments; `program` in a profile")
    folder: Path | None = setting(None, "its working directory; null: the workspace", must_exist=True)
    environment: dict[str, str] = setting({}, "further variables of its environment")
    stop_signal: str = setting("SIGTERM", "asks it, and its process group, to end", choices=STOP_SIGNALS)
    ready_line: str = setting("", "it is ready when it has printed a line with this text")
    alive_line: str = setting("", "text of lines that must keep coming")
    alive_topic: str = setting("", "type, or type and topic, of messages that must keep coming")
    alive_port: int = setting(
        0, "TCP port of this machine that must answer; 0: none", minimum=0, maximum=65535
    )
    within_s: float = setting(5.0, "longest time without a sign of life", minimum=0.1)

    @classmethod
    def check(cls, settings: dict[str, Any]) -> None:
        """Check that there is such a program, and what shows that it lives."""
        command = settings["command"]
        if not command or not command[0]:
            raise SettingError(
                "expected a program, and its arguments, as [ros2, run, my_package, my_node]", "command"
            )
        path = settings["environment"].get("PATH")
        if "/" in command[0]:
            # Of the workspace, the process that checks a profile knows no more than that it imports from it.
            folders = [settings["folder"]] if settings["folder"] else [Path.cwd(), *map(Path, sys.path)]
            places = [folder / command[0] for folder in folders]
            may_come = not any(
                place.parent.is_dir() for place in places
            )  # such as a disk that is mounted later
            if not (may_come or any(shutil.which(place) for place in places)):
                found = next((place for place in places if place.is_file()), None)
                remedy = f"; `chmod +x {found}` makes it one" if found else ""
                raise SettingError(f"there is no program {command[0]!r}{remedy}", "command")
        elif shutil.which(command[0], path=path) is None:
            where = "the PATH in `environment`" if path else "PATH"
            raise SettingError(
                f"there is no program {command[0]!r} in {where}; install it, or source its setup",
                "command",
            )
        if len(settings["alive_topic"].split()) > 2:
            raise SettingError(
                "expected a type, or a type and a topic, such as 'LaserScan front'", "alive_topic"
            )

    def setup(self) -> None:
        """Start the program, and wait until it is ready."""
        planned, workspace = self._planned()
        lines = [text for text in (self.ready_line, self.alive_line) if text]
        self._watch = LineWatch(lines) if lines else None
        environment = {name: text for name, text in os.environ.items() if name != CHANNEL_VARIABLE}
        self._message_s: float | None = None
        self._port_s: float | None = None
        self._looked_s = self._called_s = self._cpu_s = 0.0
        if self.alive_topic:
            name, _, topic = self.alive_topic.partition(" ")
            type_name = name if "/" in name else f"*/{name}"
            newest = MessageHandling.KEEP_ONLY_NEWEST
            self.subscribe_encoded(type_name, self._on_message, topic=topic.strip(), handling=newest)
        remove_dead_participants()  # if this module was killed with its program
        self.process = GuardedProcess(
            self.command,
            {"PYTHONUNBUFFERED": "1", **environment, **self.environment},
            self.folder or workspace,
            signal.Signals[self.stop_signal],
            planned.stop_grace_s * GRACE_SHARE,
            self._watch,
        )
        self.status = "waits until it is ready"
        while not self._is_ready() and not self.stop_requested and self.process.code is None:
            time.sleep(POLL_S)
        self._begun_s = time.monotonic()

    def _planned(self) -> tuple[ModuleSpec, Path | None]:
        """Return what the profile says about this module, and the workspace; in a test, the defaults."""
        if not self.run_id:
            return ModuleSpec(self.name, ""), None
        run = next(run for run in list_runs() if run.run_id == self.run_id)
        plan = RunPlan.load(run.folder)
        return next(one for one in plan.modules if one.name == self.name), Path(plan.workspace)

    def _is_ready(self) -> bool:
        has_line = not self.ready_line or (self._watch is not None and self.ready_line in self._watch.seen_s)
        return has_line and (not self.alive_port or self._port_answers())

    def _on_message(self, _message: EncodedMessage) -> None:
        self._message_s = time.monotonic()

    def tick(self) -> None:
        """End with the program, or end it because it is silent.

        Raises:
            ProgramSilent: it gives no sign of life.
            SystemExit: it has ended, not with 0; the code is its own.
        """
        code = self.process.code
        if code == 0:
            self.log.info("%s has ended", self.command[0])
            self.stop()
        elif code is not None:
            self.log.error("%s: %s", self.command[0], outcome(code))
            raise SystemExit(code & 0xFF)
        else:
            self._look()

    def _look(self) -> None:
        now_s = time.monotonic()
        if self.alive_port and now_s - self._called_s >= min(LOOK_S, self.within_s / 3):
            self._called_s = now_s
            if self._port_answers():
                self._port_s = now_s
        for what, seen_s in self._signs():
            silent_s = time.monotonic() - max(self._begun_s, seen_s or 0.0)
            if silent_s > self.within_s:
                raise ProgramSilent(f"{self.command[0]}: {what} for {silent_s:.1f} s; it is ended")
        if now_s - self._looked_s >= LOOK_S:
            self._show_usage(now_s)

    def _signs(self) -> Iterator[tuple[str, float | None]]:
        """Yield each sign of life that is expected: how its absence is called, and when it was last seen."""
        if self.alive_topic:
            yield f"no message of {self.alive_topic}", self._message_s
        if self.alive_port:
            yield f"no answer at port {self.alive_port}", self._port_s
        if self.alive_line and self._watch is not None:
            yield f"no line with {self.alive_line!r}", self._watch.seen_s.get(self.alive_line)

    def _port_answers(self) -> bool:
        try:
            with socket.create_connection(("127.0.0.1", self.alive_port), CONNECT_LIMIT_S):
                return True
        except OSError:
            return False

    def _show_usage(self, now_s: float) -> None:
        count, cpu_s, rss_bytes = self.process.usage()
        share = max(0.0, cpu_s - self._cpu_s) / (now_s - self._looked_s) if self._looked_s else 0.0
        self._looked_s, self._cpu_s = now_s, cpu_s
        self.status = f"{count} processes, {share:.0%} of a processor, {rss_bytes >> 20} MiB"

    def teardown(self) -> None:
        """End the program and its whole tree, and remove what it left in shared memory if it was killed."""
        self.process.stop()
        remove_dead_participants()
