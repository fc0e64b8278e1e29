"""Finds a run, and reads what it has left: figures, trace, clips. It may run, have ended, or be killed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from robbie_mp.attached.views.run_figures import as_data
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.regular_file import open_regular
from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.transport.board import TOOL_PREFIX
from robbie_mp.logs.black_box.clip_folder import SavedClip, clip_folders, saved_clips
from robbie_mp.logs.message_logger import RECORDING_INTO
from robbie_mp.run.live_runs import matching_runs
from robbie_mp.run.results import NAME as RESULTS
from robbie_mp.run.run_directory import KnownRun, list_runs
from robbie_mp.run.supervisor.run import SUMMARY_FILE
from robbie_mp.run.trace.crash import CrashReport
from robbie_mp.run.trace.entry import Entry
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.trace.reader import LOG_FOLDER, crash_reports, files_of, module_names, trace_folder

OUTPUT = Path("output")
"""Where runs write their results, unless they are told otherwise."""
MAX_SUMMARY_BYTES = 64 << 20
LATEST_S = 4.2e9
"""Begin of 2103, seconds since 1970."""
MAX_REMARKS = 20_000
MAX_LINE_BYTES = 1 << 22
"""Of a trace; a damaged one may have no end of a line."""
MAX_RESULTS = 20_000
"""Folders of results that are looked at."""
_WANTED = re.compile(rb'"stream":"supervisor"|"kind":"error"|' + re.escape(RECORDING_INTO.strip().encode()))


def is_time(time_s: object) -> bool:
    """Whether this is a time since 1970 that a run can have; files may be damaged."""
    return isinstance(time_s, int | float) and 0.0 <= time_s < LATEST_S


class NoResults(RobbieError, LookupError):
    """There are no results to report on.

    Example scenarios:
      - no robot has run here; results are in another folder
      - a folder is named that no run has written
    """


class Book(msgspec.Struct):
    """What became of the messages of one subscription."""

    type_name: str = ""
    topic: str = ""
    routed: int = 0
    delivered: int = 0
    replaced: int = 0
    dropped: int = 0
    left: int = 0
    lost: int = 0
    waiting: int = 0

    @property
    def adds_up(self) -> bool:
        """Whether every message is accounted for."""
        return self.routed == self.delivered + self.replaced + self.dropped + self.lost + self.waiting


class ModuleSummary(msgspec.Struct):
    """The figures of one process, as `robbie top --json` and the summary have them."""

    name: str
    state: str = ""
    reason: str = ""
    restarts: int = 0
    cpu_s: float = 0.0
    rss_bytes: int = 0
    published: int = 0
    refused: int = 0
    handled: int = 0
    ill_formed: int = 0
    status: str = ""
    states: str = ""
    health: str = ""
    subscriptions: list[Book] = []


class Summary(msgspec.Struct):
    """The file `summary.json`."""

    profile: str = ""
    exit_code: int = 0
    reason: str = ""
    degraded: dict[str, str] = {}
    duration_s: float = 0.0
    modules: list[ModuleSummary] = []


@dataclass
class ReportedRun:
    """What is known about a run without reading its messages."""

    folder: Path
    run_id: str = ""
    profile: str = ""
    is_live: bool = False
    summary: Summary | None = None
    """None: it runs, or it was killed."""
    modules: list[ModuleSummary] = field(default_factory=list)
    """Supervisor, modules, core; [] if nothing is left of their figures."""
    remarks: list[Entry] = field(default_factory=list)
    """The supervisor's remarks about its children and itself, and errors, in their order."""
    crashes: list[CrashReport] = field(default_factory=list)
    clips: list[SavedClip] = field(default_factory=list)
    logs: list[Path] = field(default_factory=list)
    """Recordings that modules of the run have written."""
    begin_s: float = 0.0
    """Seconds since 1970; 0: not known."""
    end_s: float = 0.0
    notes: list[str] = field(default_factory=list)
    """What the report cannot say, and why."""

    @property
    def duration_s(self) -> float:
        """How long it ran, or has run so far."""
        return self.summary.duration_s if self.summary else max(0.0, self.end_s - self.begin_s)


def choose_results(named: str | None, output: Path = OUTPUT) -> tuple[Path, KnownRun | None]:
    """Return the folder with a run's results, and the run if it lives or has just died.

    Args:
        named: a folder, a run's id, or a profile, whose newest run is meant; None: the run of this workspace,
            otherwise the newest one.
        output: folder with results.

    Raises:
        NoResults: there are none.
    """
    known = [run for run in list_runs() if run.record]
    if named is not None and Path(named).is_dir() and _is_results(Path(named)):
        folder = Path(named).resolve()
        return folder, next((run for run in known if _folder_of(run) == folder), None)
    runs = matching_runs(named, [run for run in known if run.is_live])
    if len(runs) > 1:
        raise NoResults(f"several runs match: {', '.join(run.run_id for run in runs)}; name one")
    if runs:
        return _folder_of(runs[0]), runs[0]
    found = sorted(_results_below(output, named), key=lambda path: path.name)
    if not found:
        of = f" of {named!r}" if named else ""
        raise NoResults(f"there are no results{of} in {output}; name the folder of a run")
    folder = found[-1].resolve()
    return folder, next((run for run in known if _folder_of(run) == folder), None)


def _folder_of(run: KnownRun) -> Path:
    assert run.record is not None
    return Path(run.record.output_directory).resolve()


def _is_results(folder: Path) -> bool:
    return (folder / LOG_FOLDER).is_dir() or (folder / SUMMARY_FILE).is_file()


def _results_below(output: Path, profile: str | None) -> Iterator[Path]:
    """Yield the results of a profile, or of all."""
    below = output / profile.removeprefix("robbie:") if profile else output
    pattern = "*" if profile else "**/*"
    for count, path in enumerate(below.glob(pattern)):
        if count > MAX_RESULTS:
            return
        if RESULTS.fullmatch(path.name) and not path.is_symlink() and _is_results(path):
            yield path


def read_run(folder: Path, known: KnownRun | None) -> ReportedRun:
    """Read what a run has left in its folder for results, and its figures if its memory is still there."""
    run = ReportedRun(folder)
    if known is not None and known.record is not None:
        run.run_id, run.profile, run.is_live = known.run_id, known.record.profile, known.is_live
    _read_trace(run)
    run.crashes = crash_reports(folder)
    run.clips = [one for one in saved_clips(clip_folders(folder)) if one.folder.parent.parent == folder]
    described = [clip.about for clip in run.clips if clip.about]
    run.run_id = run.run_id or next((about.run_id for about in described), "")
    run.profile = run.profile or next((about.profile for about in described), "")
    if not run.is_live:
        _read_summary(run)
    if run.summary is None and known is not None:
        _read_figures(run, known.run_id)
    if not run.modules:
        run.notes.append("The figures of its modules are lost: it was killed before it could write them.")
    if run.summary is not None and run.begin_s:
        run.end_s = run.begin_s + run.summary.duration_s
    run.profile = run.profile or folder.parent.name
    return run


def _read_summary(run: ReportedRun) -> None:
    path = run.folder / SUMMARY_FILE
    try:
        with open_regular(path) as file:
            content = file.read(MAX_SUMMARY_BYTES)
        run.summary = msgspec.json.decode(content, type=Summary)
    except FileNotFoundError:
        return
    except (OSError, ValueError) as error:
        run.notes.append(f"{SUMMARY_FILE} cannot be read: {error}")
        return
    run.modules = run.summary.modules
    run.profile = run.profile or run.summary.profile


def _read_figures(run: ReportedRun, run_id: str) -> None:
    """Read the figures from the shared memory of a run that lives, or whose supervisor was killed."""
    try:
        with closing(RunObserver(run_id)) as observer:
            figures = [one for one in observer.modules() if not one.name.startswith(TOOL_PREFIX)]
    except (RobbieError, OSError):
        return
    run.modules = msgspec.convert([as_data(one) for one in figures], list[ModuleSummary])


def _read_trace(run: ReportedRun) -> None:
    """Read the supervisor's remarks, errors, and where modules have recorded."""
    found: list[Entry] = []
    for name in module_names(run.folder):
        for path in files_of(trace_folder(run.folder), name):
            found += _entries_in(path)
    found.sort(key=lambda entry: entry.number)
    for entry in found:
        if entry.stream == "log" and entry.text.startswith(RECORDING_INTO):
            log = Path(entry.text.removeprefix(RECORDING_INTO))
            run.logs += [log] if log not in run.logs else []
    run.remarks = [one for one in found if one.stream == "supervisor" or one.kind is Kind.ERROR]
    if len(run.remarks) > MAX_REMARKS:
        run.notes.append(
            f"Only the last {MAX_REMARKS} of {len(run.remarks)} remarks of the supervisor count."
        )
        del run.remarks[:-MAX_REMARKS]
    if found:
        run.begin_s, run.end_s = found[0].time_s, found[-1].time_s


def _entries_in(path: Path) -> Iterator[Entry]:
    try:
        with open_regular(path) as file:
            while line := file.readline(MAX_LINE_BYTES):
                if _WANTED.search(line) and (entry := Entry.from_line(line)) and is_time(entry.time_s):
                    yield entry
    except OSError:
        return  # rotated away in the meantime, or no file
