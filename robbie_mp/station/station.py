"""The module that serves the page. Without the extra `gui`, it reports what is missing and ends."""

from __future__ import annotations

import contextlib
import socket
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.extras import how_to_install
from robbie_mp.base.linux.priority import MAX_SLICE_MS
from robbie_mp.module.listening import check_listening
from robbie_mp.module.secret import reveal
from robbie_mp.module.settings import SettingError
from robbie_mp.run.operator_link import remove_link, token_of_run, write_link
from robbie_mp.run.trace.log_limit import limited
from robbie_mp.station.module import StationModule
from robbie_mp.station.page.identity import COLOUR
from robbie_mp.station.page.layouts import LayoutError, check_layout
from robbie_mp.station.panel_classes import FRAMEWORK_PANELS, load_panels
from robbie_mp.station.web.access import Access
from robbie_mp.station.web.claim import StationClaim
from robbie_mp.station.web.listening import AddressUnusable, listen
from robbie_mp.station.web.proxy import AddressInvalid, check_proxies, public_address

if TYPE_CHECKING:
    from robbie_mp.station.web.website import Website

MODEL_SUFFIXES = (".stl", ".glb", ".gltf")
"""Suffixes of files with a robot's shape."""


EVERYWHERE = ("0.0.0.0", "::")
"""Addresses that stand for all of this machine."""


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
            f"no operator station: the library {error.name} is missing; "
            f"install the extra `gui`: {how_to_install('gui')}"
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


def _check_addresses(public: str, proxies: list[str]) -> None:
    """Check the addresses of the page behind a proxy, and of the proxies."""
    name = "public_address"
    try:
        public_address(public)
        name = "trusted_proxies"
        check_proxies(proxies)
    except AddressInvalid as error:
        raise SettingError(str(error), name) from None


class OperatorStation(StationModule):
    """Serves the page of this robot.

    In a profile: `operator: {class: "robbie_mp.station:OperatorStation"}`. It accepts connections only from
    this machine, unless you set `host` to another address; then you must also set a token.
    """

    slice_ms = MAX_SLICE_MS
    """Its maps and pictures delay other modules less: any of them that wakes up interrupts it."""
    follows_run_clock = False

    @classmethod
    def check(cls, settings: dict[str, Any]) -> None:
        """Check that only authorized people can steer the robot, and that every tab is a panel."""
        tokens = {name: settings[name] for name in ("operator_token", "observer_token")}
        check_listening(settings["host"], "operator_token", **tokens)
        _check_addresses(settings["public_address"], settings["trusted_proxies"])
        if len(settings["robot_size_m"]) != 3:
            raise SettingError("expected three numbers: length, width and height", "robot_size_m")
        if not COLOUR.fullmatch(settings["robot_colour"]):
            raise SettingError("expected a colour such as #ff6f00", "robot_colour")
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
        super().setup()
        folder = self.known_run.folder
        self._claim = StationClaim(folder)
        before = self.restored or {"port": 0, "sessions": {}}
        token = reveal(self.operator_token) or token_of_run(folder)
        refusals = limited(f"{self.log.name}.refusals")
        self.access = Access(token, reveal(self.observer_token), before["sessions"], refusals)
        listener = self._listen(before["port"])
        self._website = website(self, self.access, listener)
        self._website.start()
        self._port = listener.getsockname()[1]
        own = f"http://{self.host}:{self._port}/"
        public = str(public_address(self.public_address)) if self.public_address else ""
        self.address = f"{public} (a proxy, to {own})" if public else own
        host = socket.gethostname() if self.host in EVERYWHERE else self.host
        self.page_address = public or f"http://{host}:{self._port}/"
        self._remember()
        self._claim.announce(self.address)
        self.link = public or own
        if not self.operator_token:
            self.link += f"login?token={quote(token)}"
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

    def tick(self) -> None:
        """Check the page server, and do the work that is common to all pages."""
        if self._website is None:
            return
        super().tick()
        self._website.tick()
        if self.access.sessions != self._remembered:
            self._remember()
        refused = self._website.foreign_requests
        told = f", {refused} requests from pages of other sites refused" if refused else ""
        if failed := self._website.failed_videos:
            told += f", the video of pages failed {failed} times"
        self.status = f"{self.address}, {self._website.open_pages} pages open{told}"

    def teardown(self) -> None:
        """Stop the page server."""
        if self._website is None:
            return
        self._website.close()
        remove_link(self.known_run.folder)
        self._claim.close()
