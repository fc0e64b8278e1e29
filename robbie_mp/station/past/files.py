"""Files to take home from the page: clips and recordings, snapshots, and the report of the run so far."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import app
from starlette.background import BackgroundTask
from starlette.responses import FileResponse, PlainTextResponse, Response

from robbie_mp.base.linux.private_files import make_private_folder
from robbie_mp.base.utc import file_stamp
from robbie_mp.logs.black_box.clip_folder import CLIPS
from robbie_mp.logs.black_box.state import CLIP_NAME
from robbie_mp.station.past.apart import last_line, start_apart
from robbie_mp.station.past.recordings import NAME as RECORDING_NAME
from robbie_mp.station.past.recordings import RECORDINGS
from robbie_mp.station.past.snapshots import NAME as SNAPSHOT_NAME
from robbie_mp.station.past.snapshots import SNAPSHOTS

if TYPE_CHECKING:
    from collections.abc import Callable

CLIP_PATH, REPORT_PATH = "/clips/", "/report"
RECORDING_PATH, SNAPSHOT_PATH = "/recordings/", "/snapshots/"
LONGEST_S = 300.0
FOLDER = "downloads"


class RunFiles:
    """Makes the files, one at a time, each in a process of its own, and serves them.

    Args:
        run_folder: the folder of the run, which ends with it.
        output_directory: the results of the run.
        profile: name of the robot's profile.
    """

    def __init__(self, run_folder: Path, output_directory: Path, profile: str):
        self._folder = run_folder / FOLDER
        self._output_directory = output_directory
        self._profile = profile.rpartition("/")[2].rpartition(":")[2] or "robot"
        self._one_at_a_time = threading.Lock()
        add = app.add_api_route
        add(f"{CLIP_PATH}{{name}}", self._clip, include_in_schema=False, response_class=Response)
        add(f"{RECORDING_PATH}{{name}}", self._recording, include_in_schema=False, response_class=Response)
        add(f"{SNAPSHOT_PATH}{{name}}", self._snapshot, include_in_schema=False, response_class=Response)
        add(REPORT_PATH, self._report, include_in_schema=False, response_class=Response)

    def _clip(self, name: str) -> Response:
        """Answer with a clip; runs in a thread of the page server."""
        folder = self._output_directory / CLIPS / name
        if not CLIP_NAME.fullmatch(name) or not folder.is_dir():
            return PlainTextResponse("there is no such clip, or newer ones have taken its place\n", 404)
        return self._log(name, folder)

    def _recording(self, name: str) -> Response:
        """Answer with a recording; runs in a thread of the page server."""
        folder = self._output_directory / RECORDINGS / name
        if not RECORDING_NAME.fullmatch(name) or not folder.is_dir():
            return PlainTextResponse("there is no such recording\n", 404)
        return self._log(f"recording-{name}", folder)

    def _snapshot(self, name: str) -> Response:
        """Answer with a picture; runs in a thread of the page server."""
        path = self._output_directory / SNAPSHOTS / name
        if not SNAPSHOT_NAME.fullmatch(name) or not path.is_file():
            return PlainTextResponse("there is no such snapshot\n", 404)
        return FileResponse(path, filename=name)

    def _log(self, name: str, folder: Path) -> Response:
        """Answer with the parts of a log in one file."""
        merge = ["recording", "merge", str(folder), "--output"]
        return self._made(f"{name}.mcap", lambda path: [*merge, str(path)])

    def _report(self) -> Response:
        """Answer with the report; runs in a thread of the page server."""
        name = f"report-{self._profile}-{file_stamp()}.html"
        return self._made(name, lambda path: ["report", str(self._output_directory), "--output", str(path)])

    def _made(self, name: str, command: Callable[[Path], list[str]]) -> Response:
        if not self._one_at_a_time.acquire(blocking=False):
            return PlainTextResponse("another file is being made; try again in a moment\n", 503)
        try:
            make_private_folder(self._folder)
            folder = Path(tempfile.mkdtemp(dir=self._folder))
            try:
                path = folder / name
                _run(command(path), folder)
                leave = BackgroundTask(shutil.rmtree, folder, ignore_errors=True)
                return FileResponse(path, filename=name, background=leave)
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                raise
        except (OSError, subprocess.SubprocessError) as error:
            return PlainTextResponse(f"{name} cannot be made: {error}\n", 500)
        finally:
            self._one_at_a_time.release()


def _run(arguments: list[str], folder: Path) -> None:
    """Run a command to its end.

    Raises:
        OSError: it fails; the text says why.
        TimeoutExpired: it takes too long.
    """
    output = folder / "output"
    process = start_apart(arguments, folder, output)
    try:
        code = process.wait(LONGEST_S)
    finally:
        process.kill()
        process.wait()
    if code:
        raise OSError(last_line(output) or f"exit code {code}")
