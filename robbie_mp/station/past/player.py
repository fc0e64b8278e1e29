"""Plays one clip: a run of its own in processes of their own, whose page the station passes on.

Nothing in that run can reach the robot: it has its own shared memory, and nobody in it knows the robot's
devices. Its page is served only to this station, which passes it on below `PLAYER_PATH`; the emergency stop
on it is connected to the station itself.
"""

from __future__ import annotations

import http.client
import json
import logging
import secrets
import shutil
import signal
import socket
import subprocess
import threading
import time
from http.cookies import SimpleCookie
from pathlib import Path

from robbie_mp.base.linux.private_files import make_private_folder, write_private
from robbie_mp.logs.black_box.clip_folder import CLIPS
from robbie_mp.logs.black_box.state import CLIP_NAME
from robbie_mp.run.supervisor.sweep import sweep_base
from robbie_mp.station.past.apart import last_line, start_apart

PLAYER_PATH = "/clip-player"
"""Begins the paths of the page that plays a clip."""
FOLDER = "player"
RUNS = "robbie"
"""Folder for runs below `XDG_RUNTIME_DIR`."""
PANELS = ("map", "camera", "view", "cameras", "plots", "trace", "messages")
LAYOUT = {
    "map": [0, 0, 9, 24],
    "camera": [9, 0, 8, 13],
    "view": [17, 0, 7, 13],
    "plots": [9, 13, 8, 11],
    "trace": [17, 13, 7, 11],
}
OTHER_LAYOUTS = ("Drive", "Mission", "Engineer", "Tablet")
"""Panels that messages alone fill, and their places on the page that plays a clip; layouts that it lacks."""
START_S = 60.0
IDLE_S = 20.0
"""Time without any page after which the playback ends."""
STOP_S = 8.0
ANSWER_S = 2.0
SESSION_COOKIE = "robbie_session"


class ClipPlayer:
    """Plays at most one clip; another one takes its place.

    Any thread may call it. `tick` ends a playback that nobody looks at.

    Args:
        run_folder: the folder of the run, which ends with it.
        output_directory: the results of the run, with its clips.
        public_path: the beginning of the live page's paths; '' if no proxy adds one.
        log: receives errors.

    Attributes:
        clip: name of the clip that plays, or is being opened; '' if there is none.
        error: why the last one could not be opened; '' if it could.
        address: where its page is served, for this station alone: port and cookie; None until it is.
        pages: number of connections of pages that show it.
    """

    def __init__(self, run_folder: Path, output_directory: Path, public_path: str, log: logging.Logger):
        self.clip = self.error = ""
        self.address: tuple[int, str] | None = None
        self.pages = 0
        self.used_s = 0.0
        self._folder = run_folder / FOLDER
        self._clips = output_directory / CLIPS
        self._public_path = public_path
        self._log = log
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._sweep()  # what the playback of a station that was killed has left

    @property
    def path(self) -> str:
        """The beginning of the paths of the page that plays a clip, as browsers know it."""
        return f"{self._public_path}{PLAYER_PATH}"

    def open(self, clip: str, title: str) -> None:
        """Begin to play a clip; `address` or `error` tell when it plays. This may take seconds.

        Args:
            clip: name of its folder.
            title: what it shows, in words.
        """
        with self._lock:
            self._end()
            self.clip, self.error, self.used_s = clip, "", time.monotonic()
            try:
                port, token = self._start(clip, title)
                self.address = port, self._log_in(port, token)
            except OSError as error:
                self.error = str(error)
                self._log.warning("clip %s cannot be played: %s", clip, error)
                self._end()

    def _start(self, clip: str, title: str) -> tuple[int, str]:
        folder = self._clips / clip
        if not CLIP_NAME.fullmatch(clip) or not folder.is_dir():
            raise FileNotFoundError("there is no such clip, or newer ones have taken its place")
        port, token = _free_port(), secrets.token_urlsafe(24)
        workspace = self._folder / "workspace"
        for made in (self._folder, workspace, workspace / "profiles"):
            make_private_folder(made)
        write_private(workspace / "token", token)
        write_private(workspace / "profiles" / "clip.yaml", json.dumps(self._profile(port, title)))
        arguments = [
            "play",
            str(folder),
            "clip",
            "--loop",
            "--output",
            str(self._folder / "output"),
            "--quiet",
        ]
        # Its run is in a folder of its own, where no command takes it for a robot.
        own = {"XDG_RUNTIME_DIR": str(self._folder)}
        self._process = start_apart(arguments, workspace, self._folder / "printed", own)
        return port, token

    def _profile(self, port: int, title: str) -> dict[str, object]:
        """Return the profile of the run that plays a clip."""
        settings = {
            "host": "127.0.0.1",
            "port": port,
            "operator_token": "file:token",
            "public_address": f"http://127.0.0.1:{port}{self.path}/",
            "tabs": dict.fromkeys(PANELS, ""),
            "layouts": {"Playback": LAYOUT, **{name: {} for name in OTHER_LAYOUTS}},
            "past_of": {"path": self._public_path or "/", "title": title},
        }
        viewer = {"class": "robbie_mp.station:OperatorStation", "settings": settings}
        return {"parents": ["robbie:playback"], "black_box": False, "modules": {"clip_viewer": viewer}}

    def _log_in(self, port: int, token: str) -> str:
        """Wait until the page is there; return the session's cookie."""
        until_s = time.monotonic() + START_S
        while time.monotonic() < until_s:
            if self._process is None or self._process.poll() is not None:
                raise ChildProcessError(last_line(self._folder / "printed") or "its playback has ended")
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=ANSWER_S)
            try:
                connection.request("GET", f"/login?token={token}")
                answer = connection.getresponse()
                for name, cookie in SimpleCookie(answer.getheader("set-cookie", "")).items():
                    if name.startswith(SESSION_COOKIE):
                        self.used_s = time.monotonic()
                        return f"{name}={cookie.value}"
            except (OSError, http.client.HTTPException):
                pass  # it has not started yet
            finally:
                connection.close()
            time.sleep(0.1)
        raise TimeoutError(f"its playback has not started within {START_S:g} s")

    def tick(self) -> None:
        """End a playback that nobody looks at any more, or that has ended by itself."""
        if self.address is None or not self._lock.acquire(blocking=False):
            return
        try:
            has_ended = self._process is None or self._process.poll() is not None
            is_idle = not self.pages and time.monotonic() - self.used_s > IDLE_S
            if has_ended or is_idle:
                self.address = None
                threading.Thread(target=self.close, name="end of a clip", daemon=True).start()
        finally:
            self._lock.release()

    def close(self) -> None:
        """End the playback."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        self.clip, self.address = "", None
        process, self._process = self._process, None
        if process is not None:
            for number in (signal.SIGTERM, signal.SIGKILL):
                process.send_signal(number)
                try:
                    process.wait(STOP_S)
                    break
                except subprocess.TimeoutExpired:
                    continue
        self._sweep()

    def _sweep(self) -> None:
        sweep_base(self._folder / RUNS)
        shutil.rmtree(self._folder, ignore_errors=True)


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])
