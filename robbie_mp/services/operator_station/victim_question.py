"""The question to the operator whether that is a victim: in sight on every tab, and in nobody's way."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import VictimConfirmation
from robbie_mp.services.operator_station.access import Role
from robbie_mp.services.operator_station.panels.newest_image import NewestImage
from robbie_mp.services.operator_station.sending import header_of_now
from robbie_mp.services.operator_station.victim_watch import KnownVictim

if TYPE_CHECKING:
    from robbie_mp.services.operator_station.panel import Page
    from robbie_mp.services.operator_station.station import OperatorStation

ANSWERS = (
    ("Yes", VictimConfirmation.YES, "green-9"),
    ("No", VictimConfirmation.NO, "red-9"),
    ("Later", VictimConfirmation.LATER, "grey-8"),
)


class VictimQuestion:
    """Asks about one victim after the other; operators answer, observers see what is asked.

    It leaves keys and pointer to the page above it: who drives may go on.
    """

    def __init__(self, station: OperatorStation):
        self._station = station

    def answer(self, page: Page, number: int, answer: int) -> None:
        """Tell the robot what the operator has said about a victim."""
        header = header_of_now(self._station)
        message = VictimConfirmation(header=header, id=number, answer=answer)
        page.publish(message, "the answer")

    def build(self, page: Page) -> None:
        """Make the question for a page."""
        asked: list[KnownVictim] = []
        with (
            ui.dialog().props("seamless position=bottom") as dialog,
            ui.card().props("id=victim-question"),
            ui.row().classes("no-wrap items-center"),
        ):
            place = ui.column()
            with ui.column().classes("gap-2"):
                title = ui.label("").classes("text-lg")
                left = ui.label("").props("id=victim-time-left")
                with ui.row():
                    for text, answer, colour in ANSWERS if page.role is Role.OPERATOR else ():
                        button = ui.button(text, color=colour, on_click=lambda answer=answer: say(answer))
                        button.props(f"id=victim-{text.lower()}")

        def say(answer: int) -> None:
            if asked:
                self.answer(page, asked[0].found.id, answer)

        def update() -> None:
            first = next((one for one in self._station.victim_watch.victims.values() if one.is_asked), None)
            if first is None:
                asked.clear()
                dialog.close()
                return
            if not asked or asked[0].found.id != first.found.id:
                place.clear()
                with place:
                    image = NewestImage(f"/pictures/victim/{first.found.id}", "what the camera has seen")
                    image.style("width: 10rem; image-rendering: pixelated").show(first.count)
            asked[:] = [first]
            found = first.found
            position = found.pose.position
            title.set_text(f"Is this a victim? {found.name}, at {position.x:.2f} m, {position.y:.2f} m")
            left.set_text(f"{first.time_left_s:.0f} s left to answer; {found.confidence:.0%} sure")
            dialog.open()

        page.always(0.2, update)
