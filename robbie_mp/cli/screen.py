"""What `robbie run` prints: log lines, and below them, on a terminal, a live table of modules.

A separate thread does all the writing. A stopped (Ctrl-S) or slow terminal blocks its writer, and a closed
pipe is an error; neither may affect the robot. The supervisor's thread only puts lines into a queue. If the
queue is full, it drops the line and counts it.
"""

import contextlib
import io
import logging
import os
import queue
import select
import threading
import time
from typing import IO, cast

from rich.constrain import Constrain
from rich.live import Live

from robbie_mp.attached.views.run_figures import LIVE_FIGURES, table
from robbie_mp.base.visible_text import visible
from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.transport.segment import SegmentMissing
from robbie_mp.cli.output import PlainConsole
from robbie_mp.run.operator_link import read_link
from robbie_mp.run.run_directory import list_runs
from robbie_mp.run.supervisor.output import SUPERVISOR
from robbie_mp.run.supervisor.run import RunListener
from robbie_mp.run.supervisor.states import ChildState, StateChange
from robbie_mp.run.supervisor.supervised_child import BY_ITSELF
from robbie_mp.run.supervisor.tracebacks import tells_nothing
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind

CRITICAL = logging.getLevelName(logging.CRITICAL)
LINK = "link"
"""Used in place of a style: show the link of the operator's page if it has changed."""
REFRESH_S = 0.25
QUEUED_LINES = 1000
LAST_WORDS_S = 1.0
"""How long the end of a run waits for lines that are not written yet."""
STANDARD_ERROR = 2


def ordinal(number: int) -> str:
    """Return an ordinal, such as "3rd"."""
    ending = "th" if 10 <= number % 100 <= 20 else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"


class Unbuffered(io.TextIOBase):
    """A text file that holds no lock while it writes, so a blocked write does not block Python's exit."""

    def __init__(self, fd: int):
        self._fd = fd

    def write(self, text: str) -> int:
        """Write the whole text; blocks until that is done."""
        data = text.encode(errors="replace")
        while data:
            try:
                data = data[os.write(self._fd, data) :]
            except BlockingIOError:  # another program has made this terminal or pipe non-blocking
                select.select([], [self._fd], [])
        return len(text)

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return os.isatty(self._fd)

    def fileno(self) -> int:
        """Its descriptor."""
        return self._fd


class RunScreen:
    """Shows a run while it is entered; see the module's text.

    Attributes:
        listener: what to give to the run.
        dropped: lines that found no room.
    """

    def __init__(self, *, quiet: bool, heading: str = "", fd: int = STANDARD_ERROR):
        """Prepare.

        Args:
            quiet: show only what went wrong.
            heading: shown when the run begins, unless it is quiet.
            fd: where to write.
        """
        self._file = Unbuffered(fd)
        self._console = PlainConsole(cast("IO[str]", self._file))
        self._quiet = quiet
        self._heading = heading
        self._lines: queue.Queue[tuple[str, str]] = queue.Queue(QUEUED_LINES)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._show, name="screen", daemon=True)
        self._run_id = ""
        self._crashes: dict[str, tuple[str, int]] = {}
        """The last crash of each module, and how often it came in a row."""
        self._down: set[str] = set()
        """Modules that have ended and not come back."""
        self._reported = 0
        self._link = ""
        self.dropped = 0
        self.listener = RunListener(self._on_entry, self._on_change, self._on_begin)

    def __enter__(self) -> "RunScreen":
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        """Show the lines that still wait, if the terminal takes them quickly, and clear the table."""
        self._ended.set()
        self._put("", "")  # wakes the thread
        self._thread.join(LAST_WORDS_S)

    # -- in the supervisor's thread ----------------------------------------------------------------------

    def _on_begin(self, run_id: str) -> None:
        self._run_id = run_id
        if not self._quiet:
            self._put(self._heading, "bold")

    def _on_entry(self, entry: Entry) -> None:
        is_change = entry.stream == SUPERVISOR and entry.kind is Kind.ERROR  # which `_on_change` shows
        is_noise = entry.stream == "stderr" and tells_nothing(entry.text)
        if not self._quiet and entry.kind is not Kind.SYSTEM and not is_change and not is_noise:
            is_crash = entry.level == CRITICAL and bool(entry.traceback)
            # The last line of a traceback is the message, which may differ each time.
            again = is_crash and self._again(entry.module, entry.traceback.rpartition("\n")[0])
            for line in [f"{entry.lines()[0]}: {again}"] if again else entry.lines():
                self._put(f"[{entry.module}] {line}", "dim" if entry.stream == "stdout" else "")

    def _on_change(self, change: StateChange) -> None:
        if change.new is ChildState.RUNNING:
            self._put(change.name, LINK)
            if change.name in self._down:
                self._put(f"{change.name}: RUNNING again (start {change.incarnation})", "green")
            self._down.discard(change.name)
        if change.new is ChildState.STOPPED and change.reason.endswith(BY_ITSELF) and not self._quiet:
            self._put(f"{change.name}: STOPPED ({change.reason})", "")
        if change.new in (ChildState.FAILED, ChildState.BACKOFF):
            self._down.add(change.name)
            again = f", again in {change.restart_in_s:.2f} s" if change.restart_in_s is not None else ""
            self._put(f"{change.name}: {change.new} ({change.reason}{again})", "bold red")
            lines = [one for one in change.last_lines if not tells_nothing(one)] if self._quiet else ()
            again = self._again(change.name, "\n".join(lines)) if lines else ""
            for text in (again,) if again else lines:
                self._put(f"[{change.name}] {text}", "")

    def _again(self, module: str, crash: str) -> str:
        """Return that a crash is the same as the module's last one, and how often it was; '' if it is not."""
        before, times = self._crashes.get(module, ("", 0))
        times = times + 1 if crash == before else 1
        self._crashes[module] = (crash, times)
        return f"again, {ordinal(times)} time" if times > 1 else ""

    def _put(self, text: str, style: str) -> None:
        try:
            self._lines.put_nowait((text, style))
        except queue.Full:
            self.dropped += 1

    # -- in the screen's thread --------------------------------------------------------------------------

    def _show(self) -> None:
        with contextlib.suppress(OSError):  # the terminal or pipe is closed
            if self._quiet or not self._console.is_terminal:
                self._show_lines(None)
                return
            live = Live(
                console=self._console,
                auto_refresh=False,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            with live:
                self._show_lines(live)

    def _show_lines(self, live: Live | None) -> None:
        observer: RunObserver | None = None
        next_s = 0.0
        try:
            while not self._ended.is_set() or not self._lines.empty():
                self._print_next(live, REFRESH_S if live else None)
                if live and time.monotonic() >= next_s:
                    next_s = time.monotonic() + REFRESH_S
                    observer = observer or self._observe()
                    if observer:
                        figures = table(observer.modules(), live=True, columns=LIVE_FIGURES)
                        # An echoed ^C in a full line would begin a new one, which Live does not know of.
                        width = self._console.width - len("^C")
                        live.update(Constrain(figures, width), refresh=True)
        finally:
            if observer:
                observer.close()

    def _observe(self) -> RunObserver | None:
        with contextlib.suppress(SegmentMissing):
            return RunObserver(self._run_id) if self._run_id else None
        return None

    def _print_next(self, live: Live | None, timeout_s: float | None) -> None:
        with contextlib.suppress(queue.Empty):
            text, style = self._lines.get(timeout=timeout_s)
            if style == LINK:
                self._show_link(live)
            elif text:
                self._print(live, text, style)
        if (missing := self.dropped - self._reported) and self._lines.empty():
            self._reported += missing
            self._print(live, f"({missing} lines not shown: the terminal was too slow; see `robbie log`)", "")

    def _show_link(self, live: Live | None) -> None:
        """Show the link of the operator's page. Only a terminal gets a link that contains a token."""
        run = next((one for one in list_runs() if one.run_id == self._run_id), None)
        link = read_link(run.folder) if run else ""
        if link == self._link:
            return
        self._link = link
        if self._console.is_terminal or "?" not in link:
            self._print(live, f"operator station: {link}", "")
        else:
            self._print(live, "operator station: `robbie gui --link` shows its link", "")

    def _print(self, live: Live | None, text: str, style: str) -> None:
        if live is None:
            self._file.write(visible(text) + "\n")
        else:
            self._console.print(text, style=style, markup=False, soft_wrap=True)
