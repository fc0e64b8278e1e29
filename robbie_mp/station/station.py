"""The module that serves the page. Without the extra `gui`, it reports what is missing and ends."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.priority import MAX_SLICE_MS
from robbie_mp.messages import Goal, Message, TimeJump
from robbie_mp.module.calls.errors import CallError
from robbie_mp.module.envelope import MessageType
from robbie_mp.module.listening import check_listening
from robbie_mp.module.module import MessageHandling, Module, setting
from robbie_mp.module.secret import Secret, reveal
from robbie_mp.module.settings import SettingError
from robbie_mp.run.operator_link import remove_link, token_of_run, write_link
from robbie_mp.run.run_directory import list_runs
from robbie_mp.run.trace.log_limit import limited
from robbie_mp.scene import SceneGraphListener
from robbie_mp.station.claim import StationClaim
from robbie_mp.station.driving.seat import DriversSeat
from robbie_mp.station.live import LiveParts
from robbie_mp.station.map.marks import MapMarks, PlacesWatch
from robbie_mp.station.page.layouts import LayoutError, check_layout
from robbie_mp.station.panel_classes import FRAMEWORK_PANELS, load_panels
from robbie_mp.station.requests import Asked, Asking, Requests
from robbie_mp.station.watch.latest import Latest
from robbie_mp.station.watch.run import RunWatch
from robbie_mp.station.watch.settings import SettingsWatch
from robbie_mp.station.web.access import Access
from robbie_mp.station.web.listening import AddressUnusable, listen

if TYPE_CHECKING:
    from robbie_mp.station.context import Page
    from robbie_mp.station.driving.command import RobotCommand
    from robbie_mp.station.driving.motion import Motion
    from robbie_mp.station.watch.cameras import Cameras
    from robbie_mp.station.watch.lights import LightsWatch
    from robbie_mp.station.web.website import Website

REPLY_S = 3.0
"""Maximum time that an operator waits for the reply to a request."""
MODEL_SUFFIXES = (".stl", ".glb", ".gltf")
"""Suffixes of files with a robot's shape."""


class ExtraMissing(RobbieError, ImportError):
    """A library that the operator station needs is not installed."""


def load_website() -> type[Website]:
    """Import the application that serves the page.

    Raises:
        ExtraMissing: the extra `gui` is not installed.
    """
    try:
        from robbie_mp.station.web.website import Website  # noqa: PLC0415 - see above
    except ModuleNotFoundError as error:
        raise ExtraMissing(
            f"no operator station: the library {error.name} is missing; pip install 'robbie-mp[gui]'"
        ) from error
    return Website


def _check_panels(
    class_paths: list[str], tabs: dict[str, str], layouts: dict[str, dict[str, list[int]]]
) -> None:
    """Check that all panels exist, that every tab is one of them, and that layouts have only such tabs."""
    try:
        known = [*FRAMEWORK_PANELS, *load_panels(class_paths)]
    except ModuleNotFoundError:
        return  # without the extra `gui` there is no page; `setup` reports what is missing
    for name in tabs:
        if name not in known:
            raise SettingError(f"there is no panel {name!r}; expected one of {', '.join(known)}", "tabs")
    try:
        for name, places in layouts.items():
            check_layout(name, places, tabs or known)
    except LayoutError as error:
        raise SettingError(str(error), "layouts") from None


class OperatorStation(Module):
    """Serves the page of this robot.

    In a profile: `operator: {class: "robbie_mp.station:OperatorStation"}`. It accepts connections only from
    this machine, unless you set `host` to another address; then you must also set a token.
    """

    slice_ms = MAX_SLICE_MS
    """Its maps and pictures delay other modules less: any of them that wakes up interrupts it."""
    follows_run_clock = False
    motion: Motion
    robot_command: RobotCommand
    cameras: Cameras
    lights: LightsWatch
    host: str = setting("127.0.0.1", "address to listen on; 0.0.0.0: all addresses of this machine")
    port: int = setting(8080, "port to listen on; 0: any free port", minimum=0, maximum=65535)
    operator_token: Secret | None = setting(
        None, "token of operators; null: a new one for each run, in the printed link"
    )
    observer_token: Secret | None = setting(None, "token of observers; null: there are no observers")
    panels: list[str] = setting(
        [], "your robot's own panels, each package.module:Class, besides the framework's"
    )
    tabs: dict[str, str] = setting(
        {}, "panels to show, in this order, with their titles ('': the panel's own); {}: all useful panels"
    )
    layouts: dict[str, dict[str, list[int]]] = setting(
        {}, "layouts by name: [x, y, width, height] of each panel on a grid of 24 x 24; {}: none of this name"
    )
    layouts_file: Path | None = setting(
        None, "file with the layouts that operators save; null: in the folder of the run, which ends with it"
    )
    max_linear_m_per_s: float = setting(0.7, "maximum forward speed of manual driving", minimum=0.05)
    max_angular_rad_per_s: float = setting(1.5, "maximum turn rate of manual driving", minimum=0.1)
    map_topic: str = setting("", "topic of the map to show, if the robot has several; '' for any")
    robot_size_m: list[float] = setting(
        [0.45, 0.35, 0.25], "length, width and height of the robot in the 3-D view", minimum=0.01
    )
    robot_model: Path | None = setting(
        None, "shape of the robot in base_link, m, as STL or glTF (.stl, .glb); null: a box", must_exist=True
    )
    poses: dict[str, dict[str, float]] = setting(
        {}, "poses by name, each with the positions (rad) of joints by name; `joints` offers them"
    )
    speech_commands: list[str] = setting([], "speech commands of the robot")
    persons: list[str] = setting([], "names of persons that the robot knows")
    objects: list[str] = setting([], "names of objects that the robot knows")
    period_s: float = setting(0.05, "time between updates of moving parts", minimum=0.01)

    @classmethod
    def check(cls, settings: dict[str, Any]) -> None:
        """Check that only authorized people can steer the robot, and that every tab is a panel."""
        tokens = {name: settings[name] for name in ("operator_token", "observer_token")}
        check_listening(settings["host"], "operator_token", **tokens)
        if len(settings["robot_size_m"]) != 3:
            raise SettingError("expected three numbers: length, width and height", "robot_size_m")
        model = settings["robot_model"]
        if model is not None and model.suffix.lower() not in MODEL_SUFFIXES:
            expected = " or ".join(MODEL_SUFFIXES)
            raise SettingError(f"expected a file {expected}; got {model.name}", "robot_model")
        _check_panels(settings["panels"], settings["tabs"], settings["layouts"])

    def setup(self) -> None:
        """Create the panels, which subscribe to messages, and start the server."""
        self._website: Website | None = None
        try:
            website = load_website()
        except ExtraMissing as missing:
            self.status = str(missing)
            self.log.error("%s", missing)
            self.stop()
            return
        self.known_run = next(run for run in list_runs() if run.run_id == self.run_id)
        self._claim = StationClaim(self.known_run.folder)
        before = self.restored or {"port": 0, "sessions": {}}
        folder = self.known_run.folder
        token = reveal(self.operator_token) or token_of_run(folder)
        self.access = Access(token, reveal(self.observer_token), before["sessions"])
        self.refusals = limited(f"{self.log.name}.refusals")
        self.drivers_seat = DriversSeat()
        self.pages: dict[str, Page] = {}
        self.run_watch = RunWatch(self.run_id)
        self._requests = Requests(self._send)
        self._newest: dict[tuple[str, str], Latest[Any]] = {}
        self._handlers: dict[tuple[str, str], list[Callable[[Any], None]]] = {}
        self.scene = SceneGraphListener(self, hears_time_jumps=False)
        self.hear(TimeJump, lambda _jump: self.scene.forget())
        self.live = LiveParts()
        self.map_marks = MapMarks()
        self.places_watch = PlacesWatch(self)
        self.settings_watch = SettingsWatch(self, folder)
        listener = self._listen(before["port"])
        self._website = website(self, listener)
        self._website.start()
        self._port = listener.getsockname()[1]
        self.address = f"http://{self.host}:{self._port}/"
        self._remember()
        self._claim.announce(self.address)
        self.link = self.address if self.operator_token else f"{self.address}login?token={quote(token)}"
        write_link(folder, self.link)
        self.log.info("operator station: %s", self.address)

    def _listen(self, port_before: int) -> socket.socket:
        """Listen on the same port as before a restart, where browsers reconnect."""
        if not self.port:
            with contextlib.suppress(AddressUnusable):
                return listen(self.host, port_before)
        return listen(self.host, self.port)

    def _remember(self) -> None:
        """Checkpoint sessions and port, so that browsers need no new login after a restart."""
        self._remembered = self.access.sessions
        self.checkpoint({"port": self._port, "sessions": self._remembered})

    def subscribe(
        self,
        message_type: type[MessageType],
        handler: Callable[[MessageType], None],
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
        *,
        topic: str = "",
        optional: bool = True,
        deadline_s: float | None = None,
        on_late: Callable[[], None] | None = None,
    ) -> None:
        """Subscribe as every module does, but optionally: panels show what there is."""
        super().subscribe(
            message_type,
            handler,
            handling,
            topic=topic,
            optional=optional,
            deadline_s=deadline_s,
            on_late=on_late,
        )

    def newest(self, message_type: type[MessageType], topic: str = "") -> Latest[MessageType]:
        """Return the holder of the newest message of a type and topic. All panels share it.

        Call it only in the module's thread: in `setup`, constructors of panels, and their ticks.
        """
        key = (message_type.type_name, topic)
        if key not in self._newest:
            self._newest[key] = latest = Latest[MessageType]()
            if key in self._handlers:
                self.hear(message_type, latest.put, topic)
                return latest
            self.subscribe(message_type, latest.put, MessageHandling.KEEP_ONLY_NEWEST, topic=topic)
        return self._newest[key]

    def hear(
        self, message_type: type[MessageType], handler: Callable[[MessageType], None], topic: str = ""
    ) -> None:
        """Subscribe to every message of a type and topic. Call this before `newest` of the same type.

        Call it in the module's thread, which also runs the handler.
        """
        key = (message_type.type_name, topic)
        if key not in self._handlers:
            handlers: list[Callable[[MessageType], None]] = []
            self._handlers[key] = handlers

            def handle(message: MessageType) -> None:
                for one in handlers:
                    one(message)

            self.subscribe(message_type, handle, topic=topic)
        self._handlers[key].append(handler)

    def ask(self, message: Asking, what: str, topic: str = "", within_s: float | None = None) -> Asked:
        """Send a request or a goal from any thread; see `Page.ask`.

        Args:
            message: the request or goal.
            what: a name for it in texts.
            topic: name of the service, if several modules serve the same type.
            within_s: it is not sent later than this; None: however late.
        """
        return self._requests.ask(message, what, topic, within_s)

    def _send(self, message: Asking, on_end: Callable[[Message | CallError], None], topic: str) -> None:
        if isinstance(message, Goal):
            self.send_goal(message, on_end, on_end, topic=topic)
        else:
            self.call(message, on_end, on_end, timeout_s=REPLY_S, topic=topic)

    def opened(self, page: Page) -> None:
        """Add an open page; called in the page server's thread."""
        self.pages[page.key] = page

    def closed(self, page: Page) -> None:
        """Remove a page, which then no longer drives; called in the page server's thread."""
        self.pages.pop(page.key, None)
        if self.drivers_seat.holder == page.key:
            self.drivers_seat.leave(page.key)
            self.robot_command.give_up()

    def tick(self) -> None:
        """Check the page server, and do the work that is common to all pages."""
        if self._website is None:
            return
        self._requests.tick()
        self._website.tick()
        if self.access.sessions != self._remembered:
            self._remember()
        if self.pages:
            self.run_watch.tick()
        self.status = f"{self.address}, {len(self.pages)} pages open"

    def teardown(self) -> None:
        """Stop the page server."""
        if self._website is None:
            return
        self._website.close()
        self.run_watch.close()
        remove_link(self.known_run.folder)
        self._claim.close()
