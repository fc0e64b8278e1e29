"""The module behind the page."""

from collections.abc import Callable
from typing import Any

from fastapi import FastAPI
from nicegui import ui

from robbie_mp.bus import MessageType
from robbie_mp.messages import TimeJump
from robbie_mp.module import MessageHandling, Module, setting
from robbie_mp.scene_graph import SceneGraphListener
from robbie_mp.services.operator_station.access import SHORTEST_TOKEN, Access, DriversSeat, is_loopback
from robbie_mp.services.operator_station.emergency_stop import EmergencyStopBar
from robbie_mp.services.operator_station.gate import Gate
from robbie_mp.services.operator_station.page import build_page
from robbie_mp.services.operator_station.panel import Latest, Page
from robbie_mp.services.operator_station.panels import PANELS
from robbie_mp.services.operator_station.playback_bar import PlaybackBar
from robbie_mp.services.operator_station.run_watch import RunWatch
from robbie_mp.services.operator_station.server import PageServer
from robbie_mp.services.operator_station.victim_question import VictimQuestion
from robbie_mp.services.operator_station.victim_watch import VictimWatch
from robbie_mp.settings import SettingError
from robbie_mp.supervisor.run_directory import list_runs

MESSAGE_HISTORY = 100
"""Messages kept for a page that has lost its connection; one that misses more is loaded anew."""


class OperatorStation(Module):
    """Serves the page of this robot.

    In a profile: `operator: {class: "robbie_mp.services.operator_station:OperatorStation"}`. It listens to
    this machine alone, unless `host` is another address; then there must be a token.
    """

    follows_run_clock = False
    host: str = setting("127.0.0.1", "address to listen on; 0.0.0.0: all of this machine's")
    port: int = setting(8080, "port to listen on; 0: any that is free", minimum=0, maximum=65535)
    operator_token: str = setting("", "what an operator logs in with; '': everybody here is one")
    observer_token: str = setting("", "what an observer logs in with; '': there are none")
    tabs: dict[str, str | None] = setting(
        {}, "which panels to show, in this order, and their titles (null: its own); {}: all"
    )
    max_linear_m_per_s: float = setting(0.7, "fastest that may be driven by hand", minimum=0.05)
    max_angular_rad_per_s: float = setting(1.5, "fastest that may be turned by hand", minimum=0.1)
    robot_size_m: list[float] = setting(
        [0.45, 0.35, 0.25], "length, width and height of the robot in the 3-D view", minimum=0.01
    )
    period_s: float = setting(0.2, "time between looks at the page server", minimum=0.01)

    @classmethod
    def check(cls, settings: dict[str, Any]) -> None:
        """See that nobody can steer the robot who should not, and that every tab is a panel."""
        for name in ("operator_token", "observer_token"):
            if settings[name] and len(settings[name]) < SHORTEST_TOKEN:
                raise SettingError(f"expected at least {SHORTEST_TOKEN} characters; got fewer", name)
        if not is_loopback(settings["host"]) and not settings["operator_token"]:
            raise SettingError(
                f"{settings['host']} is reached from other machines: set operator_token, a secret of at "
                f"least {SHORTEST_TOKEN} characters, or host to 127.0.0.1",
                "host",
            )
        if settings["observer_token"] and not settings["operator_token"]:
            raise SettingError("with an observer_token there must be an operator_token", "observer_token")
        if len(settings["robot_size_m"]) != 3:
            raise SettingError("expected three numbers: length, width and height", "robot_size_m")
        for name in settings["tabs"]:
            if name not in PANELS:
                raise SettingError(f"there is no panel {name!r}; expected one of {', '.join(PANELS)}", "tabs")

    def setup(self) -> None:
        """Subscribe to what the panels show, and begin to serve."""
        self.access = Access(self.operator_token, self.observer_token)
        self.drivers_seat = DriversSeat()
        self.pages: dict[str, Page] = {}
        self.run_watch = RunWatch(self.run_id)
        self.run_folder = next(run.folder for run in list_runs() if run.run_id == self.run_id)
        self._newest: dict[tuple[str, str], Latest[Any]] = {}
        self._handlers: dict[tuple[str, str], list[Callable[[Any], None]]] = {}
        self.scene = SceneGraphListener(self, hears_time_jumps=False)
        self.hear(TimeJump, lambda _jump: self.scene.forget())
        self.victim_watch = VictimWatch(self)
        titles = self.tabs or dict.fromkeys(PANELS)
        self.panels = [PANELS[name](self) for name in titles]
        titled = [(panel, titles[panel.name] or panel.title) for panel in self.panels]
        emergency_stop = EmergencyStopBar(self)
        bars = [PlaybackBar(self).build, VictimQuestion(self).build]
        page = ui.page("/", title="Robbie", response_timeout=10)
        page(lambda: build_page(self, emergency_stop, bars, titled))
        application = FastAPI(openapi_url=None)
        ui.run_with(
            application,
            dark=True,
            reconnect_timeout=5.0,
            binding_refresh_interval=None,
            message_history_length=MESSAGE_HISTORY,
            show_welcome_message=False,
        )
        self.server = PageServer(Gate(application, self.access, self.log), self.host, self.port)
        self.server.start()
        self.address = f"http://{self.host}:{self.server.port}/"
        self.log.info("operator station: %s", self.address)

    def newest(self, message_type: type[MessageType], topic: str = "") -> Latest[MessageType]:
        """Return what holds the newest message of a type and topic, which all panels share.

        In the module's thread only: in `setup`, constructors of panels, and their ticks.
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
        """Have every message of a type and topic handled, before anybody wants it by `newest`.

        Called and handled in the module's thread.
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

    def opened(self, page: Page) -> None:
        """Note a page; in the page server's thread."""
        self.pages[page.key] = page

    def closed(self, page: Page) -> None:
        """Forget a page, which drives no more; in the page server's thread."""
        self.pages.pop(page.key, None)
        self.drivers_seat.leave(page.key)

    def tick(self) -> None:
        """See that the page is served, and do what is done once for all pages."""
        self.server.check()
        if self.pages:
            self.run_watch.tick()
        for panel in self.panels:
            panel.tick()
        self.status = f"{self.address}, {len(self.pages)} pages open"

    def teardown(self) -> None:
        """End the page server."""
        self.server.close()
        for panel in self.panels:
            panel.close()
        self.run_watch.close()
