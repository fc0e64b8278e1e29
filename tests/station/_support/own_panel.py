"""Copied into the workspace of tests: a panel that is not part of the framework."""

from nicegui import ui

from robbie_mp.messages import String
from robbie_mp.station.context import StationContext
from robbie_mp.station.map.marks import MapMark
from robbie_mp.station.page.page import Page
from robbie_mp.station.panel import Panel


class FriendsPanel(Panel):
    """Shows a greeting on every tab, and where a friend is."""

    name = "friends"
    title = "Friends"
    icon = "anchor"

    def __init__(self, station: StationContext):
        super().__init__(station)
        self.said = station.messages.newest(String, "greeting")
        station.map.marks.add("friends", lambda: [MapMark("Anna", "#00897b", 2.0, 1.0, 0.5)])

    def build(self, page: Page) -> None:
        ui.label("Anna is here").classes("italic").props("id=friends-text")

    def build_on_every_tab(self, page: Page) -> None:
        ui.label("hello").props("id=friends-greeting")
