"""The question to the operator whether that is a victim: in sight on every tab, and in nobody's way."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from robbie_mp.messages import VictimConfirmation
from robbie_mp.station.access import Role
from robbie_mp.station.ages import silence
from robbie_mp.station.sending import header_of_now

if TYPE_CHECKING:
    from robbie_mp.station.panel import Page
    from robbie_mp.station.station import OperatorStation
    from robbie_mp.station.victim_watch import KnownVictim

ANSWERS = (
    ("Yes", VictimConfirmation.YES, "#2e7d32"),
    ("No", VictimConfirmation.NO, "#c62828"),
    ("Later", VictimConfirmation.LATER, "#424242"),
)
STYLE = Path(__file__).parent / "victim_question.css"
MAX_QUESTIONS = 8
"""A page knows of this many at a time; it shows one after the other."""
SILENT_AFTER_S = 10.0
"""A robot that asks says so again within this time."""


class QuestionCard(Element, component="victim_question.js"):
    """Shows one question until the robot no longer asks it, and says which victim the answer is about."""

    def __init__(self, *, can_answer: bool):
        super().__init__()
        self._props["answers"] = ANSWERS if can_answer else ()
        self._props["questions"] = []

    def show(self, questions: list[dict[str, Any]]) -> None:
        """Show one of these; the one that is shown already stays if it is among them."""
        if questions != self._props["questions"]:
            self._props["questions"] = questions
            self.update()


class VictimQuestion:
    """Asks about one victim after the other; operators answer, observers see what is asked.

    It leaves keys and pointer to the page above it: who drives may go on.
    """

    def __init__(self, station: OperatorStation):
        self._station = station

    def build(self, page: Page) -> None:
        """Make the question for a page."""
        ui.add_css(STYLE)
        card = QuestionCard(can_answer=page.role is Role.OPERATOR)

        def on_answer(event: GenericEventArguments) -> None:
            self._answer(page, event.args)

        card.on("answer", on_answer)
        page.always(0.2, lambda: card.show(self._questions()))

    def _answer(self, page: Page, sent: object) -> None:
        """Tell the robot what the operator has said about a victim."""
        answered = checked(sent)
        if answered is None or answered[0] not in self._station.victim_watch.victims:
            return
        number, answer = answered
        message = VictimConfirmation(header=header_of_now(self._station), id=number, answer=answer)
        page.publish(message, "the answer")

    def _questions(self) -> list[dict[str, Any]]:
        """Return what is asked now, what was asked first at the beginning."""
        victims = self._station.victim_watch.victims.values()
        asked = sorted((one for one in victims if one.is_asked), key=lambda one: one.asked_since_s)
        return [question(one) for one in asked[:MAX_QUESTIONS]]


def question(victim: KnownVictim) -> dict[str, Any]:
    """Return what a page shows of a victim that it is asked about."""
    found = victim.found
    position = found.pose.position
    silent = silence(victim.age_s, SILENT_AFTER_S)
    return {
        "id": found.id,
        "count": victim.image_count if found.image.data.size else 0,
        "text": f"{found.name}, at {position.x:.2f} m, {position.y:.2f} m",
        "left": f"{victim.time_left_s:.0f} s left to answer; {found.confidence:.0%} sure",
        "silent": f"nothing heard of it for {silent}: the robot may not hear the answer" if silent else "",
    }


def checked(sent: object) -> tuple[int, int] | None:
    """Return victim and answer that a page has sent; None if that is nothing that our page sends."""
    if not isinstance(sent, dict):
        return None
    number, answer = sent.get("id"), sent.get("answer")
    if type(number) is not int or type(answer) is not int or answer not in {one for _, one, _ in ANSWERS}:
        return None
    return number, answer
